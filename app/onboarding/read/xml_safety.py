"""XML that multiplies itself or reaches for other files is refused before it is read."""

from __future__ import annotations

from pathlib import Path
from xml.parsers import expat

from app.errors import RobotFileError


class _PrologRead(Exception):  # noqa: N818 - the way out of expat, not an error
    """The root element has begun: no entity can be declared any more."""


def refuse_entities(content: bytes | str, path: Path) -> None:
    """Read up to the root element; what is not well-formed after it is left to who reads the rest.

    Args:
        content: Of an XML file, as it is parsed afterwards: of a text, the encoding that it
            declares does not count.
        path: Named in the message.

    Raises:
        RobotFileError: It declares an entity, as a billion laughs do, or cannot be read so far.
    """
    parser = expat.ParserCreate("utf-8" if isinstance(content, str) else None)
    parser.EntityDeclHandler = lambda name, *_: _refuse(name, path)
    parser.StartElementHandler = _stop
    try:
        parser.Parse(content, True)
    except _PrologRead:
        pass
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter of its encoding
        raise RobotFileError(f"{path}: not well-formed: {error}") from None


def _stop(*_: object) -> None:
    raise _PrologRead


def _refuse(name: str, path: Path) -> None:
    raise RobotFileError(
        f"{path.name}: it declares the XML entity {name!r}, which could grow without end or read "
        "other files; write out what it stands for, without <!ENTITY …>"
    )
