"""`python -m app` is the console command `dbb`."""

from app.cli import console

if __name__ == "__main__":
    console()
