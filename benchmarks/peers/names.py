"""What is compared: the libraries as they come from PyPI, and our own controllers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from app.errors import UnknownNameError


class Peer(NamedTuple):
    """Something that follows the hand paths.

    Attributes:
        title: For people.
        driver: Its program among the drivers.
        requirements: What pip installs for it; nothing for our own.
        level: What it commands.
        dt: [s] between two of its steps.
        about: How its row differs from the others, for the table's notes.
    """

    title: str
    driver: str
    requirements: tuple[str, ...] = ()
    level: str = "velocity"
    dt: float = 0.005
    about: str = ""

    @property
    def own(self) -> bool:
        """Whether it is a controller of this project."""
        return not self.requirements


def _own(title: str) -> Peer:
    return Peer(title, "ours", level="torque", dt=0.001)


PEERS: dict[str, Peer] = {
    "pink": Peer(
        "pink", "pink", ("pin-pink==4.4.*", "daqp==0.*"),
        about="no-slip row as a constraint; SelfCollisionBarrier, gain 20 /s",
    ),
    "mink": Peer(
        "mink", "mink", ("mink==1.3.*", "daqp==0.*"),
        about="no-slip row as a constraint; CollisionAvoidanceLimit, gain 0.1 a step (20 /s)",
    ),
    "placo": Peer(
        "placo", "placo", ("placo==0.10.*",),
        about="no-slip row as two hard half-spaces; its avoidance has no rate: a pair may close in "
        "on d_min in one step",
    ),
    "roboplan": Peer(
        "roboplan", "roboplan", ("roboplan-oink==0.7.*",),
        about="a base that turns and drives ahead, set back to zero each step; "
        "SelfCollisionBarrier, gain 20 /s",
    ),
    "dbb": _own("proposed (DBB)"),
    "barrier": _own("our barrier rows"),
    "repulsive": _own("our repulsive force"),
}  # fmt: skip
"""By their names; the libraries, then our own controllers by the names of `--controller`."""


def chosen(names: Sequence[str]) -> dict[str, Peer]:
    """The ones of these names in the order of `PEERS`; all if none is named.

    Raises:
        UnknownNameError: No such name; lists those that exist.
    """
    for name in names:
        if name not in PEERS:
            raise UnknownNameError("peer", name, PEERS)
    return {name: peer for name, peer in PEERS.items() if name in names or not names}
