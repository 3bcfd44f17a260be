"""`dbb config`: all parameters as a file for `--config`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from app.cli.common import print_json
from app.cli.options import NO_DEFAULT, ConfigOption, Json, configured
from app.config import Config, sections
from app.config_file import save_config
from app.errors import OutputError
from app.parameters import Tunable


def config(
    config: ConfigOption = None, out: Annotated[Path | None, NO_DEFAULT] = None, json: Json = False
) -> None:
    """Print all parameters as a file that --config takes.

    Each with its unit, range and meaning.

    Args:
        out: File to write instead of printing; one that exists is not written over.
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
