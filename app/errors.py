"""`DbbError` and its subclasses, each with a one-line text, and functions that form texts."""

import difflib
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from traceback import walk_tb


class DbbError(Exception):
    """Base of all errors that a user can cause; commands print the text and end with status 2."""

    def __str__(self) -> str:
        """The message as one printable line."""
        return printable(" ".join(super().__str__().splitlines()))


def printable(text: str) -> str:
    """A text in which codes replace unprintable characters, except line feeds and tabs."""
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


def shown(value: object) -> str:
    """A value as Python writes it, in at most 60 characters; an array as a list."""
    try:
        return cut(repr(value.tolist() if getattr(value, "ndim", 0) else value))  # type: ignore[attr-defined]
    except Exception:  # an integer is too long, lists nest too deeply, or `__repr__` has an error
        return f"a {type(value).__name__} that cannot be shown"


def cut(text: str) -> str:
    """The text, or the beginning of a text with more than 60 characters."""
    return text if len(text) <= 60 else text[:57] + "…"


class UnknownNameError(DbbError):
    """A name (robot, scenario, controller, pair, …) that does not exist, or that is no text."""

    def __init__(self, kind: str, name: object, choices: Iterable[str]) -> None:
        self.choices = sorted(choices)
        known = ", ".join(self.choices) or "(none)"
        hint = did_you_mean(name, self.choices) if isinstance(name, str) else ""
        super().__init__(f"unknown {kind} {shown(name)}{hint}; choose from: {known}")


def check_name(kind: str, name: str, choices: Collection[str]) -> None:
    """Raise an UnknownNameError if `name`, of a `kind` such as `robot`, is not in `choices`."""
    if not isinstance(name, str) or name not in choices:
        raise UnknownNameError(kind, name, choices)


class DescriptionError(DbbError):
    """A robot description is missing or invalid; the message names the fault."""


class AssetError(DbbError):
    """A URDF, mesh, package or report of a robot is missing or cannot be loaded."""


class RobotFileError(DbbError):
    """A file of a robot is invalid or unsuitable; the message names the part, often a remedy."""


class ConfigError(DbbError):
    """A parameter or option is invalid, for example out of its range."""


@contextmanager
def named_part(where: str) -> Iterator[None]:
    """Put the name `where` of a part before the message of a RobotFileError in the `with`."""
    try:
        yield
    except RobotFileError as error:
        raise RobotFileError(f"{where}: {error}") from None


class UnreachableError(DbbError):
    """A scenario has no start, or no posture of the arm reaches it."""

    def __init__(self, message: str, flaws: Mapping[str, int] | None = None) -> None:
        super().__init__(message)
        self.flaws = dict(flaws or {})  # number of failed tries for each reason


class MeasurementError(DbbError):
    """A measurement or reference has a wrong type, shape or value, or joint names are wrong."""


class TargetError(DbbError):
    """A person's command is impossible, such as a target below the floor."""


class OutputError(DbbError):
    """A result cannot be written to the specified place."""


class LogError(DbbError):
    """A file or snapshots are no valid log, or a recorded instant, interval or value is missing."""


class CaseError(DbbError):
    """A case is missing, cannot be read or is invalid."""


class StudyError(DbbError):
    """A study cannot be started or continued."""


class MissingExtraError(DbbError):
    """A library is not installed; the message names the extra that installs the library."""


class ServerError(DbbError):
    """The dashboard cannot listen on the specified address."""


class BrowserError(DbbError):
    """No browser with 3D graphics is available, or the browser has failed."""


class LoopError(DbbError):
    """The simulation or a child process ended or failed, or too many commands wait."""


EXTRAS = {
    "dashboard": "fast_simplification imageio_ffmpeg msgspec PIL playwright viser websockets",
    "studies": "dask distributed jinja2 matplotlib mpl_toolkits",
    "onboarding": "collada fast_simplification jinja2 matplotlib mpl_toolkits xacro xacrodoc",
    "sim": "foxglove google mujoco pyarrow pybullet pybullet_data rosbags scipy trimesh",
}
"""The modules that each of these four extras of the package installs. Each one except `sim` also
installs `sim`, and serves the package of its name in `app`."""


@contextmanager
def extras_named() -> Iterator[None]:
    """In the `with`, a MissingExtraError replaces the error of a missing module of an extra; it
    names the extra of the importing package, or else the first one that installs the module.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        importers = [str(frame.f_globals["__name__"]) for frame, _ in walk_tb(error.__traceback__)]
        own = [extra for extra in EXTRAS if any(n.startswith(f"app.{extra}.") for n in importers)]
        for extra in (*own, *EXTRAS):
            modules = [EXTRAS[extra], EXTRAS["sim"]] if extra in own else [EXTRAS[extra]]
            if missing in " ".join(modules).split():
                raise MissingExtraError(
                    f"this needs {missing}, which is not installed; "
                    f"try: pip install 'dbb-mobile-manipulator[{extra}]'"
                ) from None
        raise


def closest(name: str, choices: Iterable[str]) -> str:
    """The choice with the most similar name, ignoring case; empty if no choice is similar."""
    known = {choice.casefold(): choice for choice in choices}
    close = difflib.get_close_matches(name.casefold(), known, n=1)
    return known[close[0]] if close else ""


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """The text ` (did you mean 'x'?)` with the `closest` choice x; empty if there is none."""
    return f" (did you mean {close!r}?)" if (close := closest(name, choices)) else ""
