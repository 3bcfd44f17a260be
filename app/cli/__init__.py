"""The console command `dbb`: one typed function for each subcommand; tyro makes its options.

A command imports slow modules in its function: other commands start without these modules, and a
wrong option is reported before the import.
"""

from app.cli.main import console, main

__all__ = ["console", "main"]
