"""The console command `dbb`: one subcommand a module, made with tyro from typed functions."""

from app.cli.main import main

__all__ = ["main"]
