"""The compared libraries in their PyPI versions, and our own controllers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from app.errors import check_name


class Peer(NamedTuple):
    """A library or controller that follows the paths of the end-effector.

    Attributes:
        title: Displayed title.
        driver: Name of its driver program.
        requirements: Packages for pip; empty for our own controllers.
        level: The quantity that it commands.
        dt: [s] time between two steps.
    """

    title: str
    driver: str
    requirements: tuple[str, ...] = ()
    level: str = "velocity"
    dt: float = 0.005

    @property
    def own(self) -> bool:
        """Whether it is a controller of this project."""
        return not self.requirements


def _own(title: str) -> Peer:
    return Peer(title, "ours", level="torque", dt=0.001)


PEERS: dict[str, Peer] = {
    "pink": Peer("pink", "pink", ("pin-pink==4.4.*", "daqp==0.*")),
    "mink": Peer("mink", "mink", ("mink==1.3.*", "daqp==0.*")),
    "placo": Peer("placo", "placo", ("placo==0.10.*",)),
    "roboplan": Peer("roboplan", "roboplan", ("roboplan-oink==0.7.*",)),
    "dbb": _own("proposed (DBB)"),
    "barrier": _own("our barrier rows"),
    "repulsive": _own("our repulsive force"),
    "none": _own("ours, no avoidance"),
}
"""The libraries by their names, then our controllers by the names of `--controller`."""


def chosen(names: Sequence[str]) -> dict[str, Peer]:
    """The peers with these names, in the order of `PEERS`; without names, all peers.

    Raises:
        UnknownNameError: A name does not exist; the message lists the existing names.
    """
    for name in names:
        check_name("peer", name, PEERS)
    return {name: peer for name, peer in PEERS.items() if name in names or not names}
