"""The console command `dbb`: a typed function each subcommand, of which tyro makes its options."""

from app.cli.main import console, main

__all__ = ["console", "main"]
