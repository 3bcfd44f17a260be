"""`dbb config`: all parameters as a file for `--config`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from app.cli.common import print_json
from app.cli.options import Json, configured
from app.config import Config, sections
from app.config_file import save_config
from app.errors import OutputError
from app.parameters import Tunable


def config(config: Path | None = None, out: Path | None = None, json: Json = False) -> None:
    """Print all parameters with units, ranges and meaning, as a file that `--config` takes.

    Args:
        config: File of parameters to begin with, some or all (default: the defaults).
        out: File to write instead of printing; one that exists is not written over.
        json: Print one JSON object on standard output and nothing else there.
    """
    tuned = configured(config)
    if out is not None:
        _write(out, save_config(tuned, out.stem))
    if json:
        print_json({"parameters": [_row(each, tuned) for s in sections() for each in s.tunables]})
    elif out is None:
        print(save_config(tuned), end="")
    else:
        print(out)


def _write(out: Path, text: str) -> None:
    try:
        with out.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise OutputError(f"--out: {out} exists; name another file or remove it") from None
    except OSError as error:
        raise OutputError(f"--out: cannot write to {out}: {error.strerror}") from None


def _row(about: Tunable, tuned: Config) -> dict[str, Any]:
    row = about.model_dump(exclude={"label", "advanced", "log"})
    return {"path": row.pop("path"), "value": tuned.value(about.path), **row}
