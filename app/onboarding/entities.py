"""XML that multiplies itself or reaches for other files is refused before it is read."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from xml.parsers import expat

from app.errors import RobotFileError


class _PrologRead(Exception):  # noqa: N818 - the way out of expat, not an error
    """The root element has begun: no entity can be declared any more."""


def refuse_entities(content: bytes, path: Path) -> None:
    """Read up to the root element; what is not well-formed is left to whoever reads the rest.

    Args:
        content: Of an XML file.
        path: Named in the message.

    Raises:
        RobotFileError: It declares an entity, as a billion laughs do.
    """
    parser = expat.ParserCreate()
    parser.EntityDeclHandler = lambda name, *_: _refuse(name, path)
    parser.StartElementHandler = _stop
    with suppress(expat.ExpatError, _PrologRead):
        parser.Parse(content, True)


def _stop(*_: object) -> None:
    raise _PrologRead


def _refuse(name: str, path: Path) -> None:
    raise RobotFileError(
        f"{path.name}: it declares the XML entity {name!r}, which could grow without end or read "
        "other files; write out what it stands for, without <!ENTITY …>"
    )
