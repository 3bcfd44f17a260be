"""The console command `dbb`: one typed function for each subcommand; tyro makes its options."""

from app.cli.main import console, main

__all__ = ["console", "main"]
