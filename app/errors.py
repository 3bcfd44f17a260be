"""One tree of exceptions: whatever a user can cause is a `DbbError` and prints as one line."""

import difflib
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from traceback import walk_tb


class DbbError(Exception):
    """Base of all errors that a user can cause and mend; the command line prints it and exits 2."""

    def __str__(self) -> str:
        """One line, whatever a file that it quotes has in it."""
        return printable(" ".join(super().__str__().splitlines()))


def printable(text: str) -> str:
    """A text for a terminal: control and direction characters are written as their codes."""
    return "".join(c if c.isprintable() or c in "\n\t" else repr(c)[1:-1] for c in text)


class UnknownNameError(DbbError):
    """A name (robot, scenario, controller, pair, …) that does not exist."""

    def __init__(self, kind: str, name: str, choices: Iterable[str]) -> None:
        self.kind, self.name, self.choices = kind, name, sorted(choices)
        """What was asked for, as in "robot", the name that was given, and those that exist."""
        super().__init__(
            f"unknown {kind} {name!r}{did_you_mean(name, self.choices)}; "
            f"choose from: {', '.join(self.choices) or '(none)'}"
        )


def check_name(kind: str, name: str, choices: Iterable[str]) -> None:
    """Refuse a name that does not exist.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    if name not in (existing := tuple(choices)):
        raise UnknownNameError(kind, name, existing)


class DescriptionError(DbbError):
    """A robot description that is missing, misspelt or out of range; names file and field."""


class AssetError(DbbError):
    """A mesh or package that a description refers to is not there."""


class RobotFileError(DbbError):
    """A URDF that cannot become a robot description; names the part, and the option that helps."""


class ConfigError(DbbError):
    """A parameter out of its range."""


class UnreachableError(DbbError):
    """No configuration of the arm brings the hand to the asked start."""

    def __init__(self, message: str, flaws: Mapping[str, int] | None = None) -> None:
        super().__init__(message)
        self.flaws = dict(flaws or {})
        """How many tries failed by each reason."""


class MeasurementError(DbbError):
    """A measurement is not what the robot's sensors give."""


class TargetError(DbbError):
    """The person's hand was told to go where it cannot, such as below the floor."""


class OutputError(DbbError):
    """A result cannot be written where it was asked for."""


class LogError(DbbError):
    """A log that cannot be read or made: damaged, not one, or with columns that are not a log's."""


class CaseError(DbbError):
    """A case of a study that cannot be read, or is of another robot."""


class StudyError(DbbError):
    """A study cannot be done or gone on with where it was asked for."""


class MissingExtraError(DbbError):
    """A library is not installed that only some commands need; names the extra that brings it."""


class ServerError(DbbError):
    """The dashboard cannot listen where it was told to."""


class BrowserError(DbbError):
    """There is no browser that can draw."""


class LoopError(DbbError):
    """The simulation thread ended with an exception, which is its cause."""


EXTRAS = {
    "dashboard": (
        "fast_simplification",
        "imageio_ffmpeg",
        "msgspec",
        "PIL",
        "playwright",
        "viser",
        "websockets",
    ),
    "onboarding": ("xacrodoc",),
    "studies": ("dask", "distributed", "jinja2", "matplotlib", "mpl_toolkits"),
    "sim": (
        *("foxglove", "google", "mujoco", "pyarrow", "pybullet", "pybullet_data", "rosbags"),
        *("scipy", "trimesh"),
    ),
}
"""The extras of the package, and the modules that each brings; all bring those of `sim`. The first
three are for the rooms of their names."""


@contextmanager
def extras_named() -> Iterator[None]:
    """A module that is missing meanwhile, and that an extra brings, is an error of one line.

    Raises:
        MissingExtraError: Says how to install the extra of the room that asked for it.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        asked = [str(frame.f_globals["__name__"]) for frame, _ in walk_tb(error.__traceback__)]
        for extra, modules in EXTRAS.items():
            if missing in modules or (
                missing in EXTRAS["sim"] and any(n.startswith(f"app.{extra}.") for n in asked)
            ):
                raise MissingExtraError(
                    f"this needs {missing}, which is not installed; "
                    f"try: pip install 'dbb-mobile-manipulator[{extra}]'"
                ) from None
        raise


def did_you_mean(name: str, choices: Iterable[str]) -> str:
    """` (did you mean 'x'?)` for the closest of the choices in any case, or an empty string."""
    known = {choice.casefold(): choice for choice in choices}
    close = difflib.get_close_matches(name.casefold(), known, n=1)
    return f" (did you mean {known[close[0]]!r}?)" if close else ""
