"""The console command `dbb`: a typed function each subcommand, of which tyro makes its options."""

from app.cli.main import main

__all__ = ["main"]
