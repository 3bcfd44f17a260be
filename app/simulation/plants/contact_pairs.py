"""Which links of the robot the physics lets touch, and how such a contact is called."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, product
from typing import NamedTuple

from app.errors import UnknownNameError
from app.robot.description import RobotDescription


class ContactPairs(NamedTuple):
    """Pairs of names, each pair in one group only; names are those of bodies or of links."""

    arm_base: frozenset[tuple[str, str]]
    """A part of l_m, and a part of the arm that can come near it."""
    arm_arm: frozenset[tuple[str, str]]
    """Parts of arm bodies that are not neighbours in the chain."""
    arm_floor: frozenset[str]
    """Parts of the arm that can reach the floor."""


def body_contact_pairs(
    description: RobotDescription, outer: Sequence[str] | None = None
) -> ContactPairs:
    """Pairs of bodies that may touch.

    Args:
        description: The robot.
        outer: Names of the arm's bodies that can come near l_m, as L_m has them; by default
            those with a reachability, which every body that may come near l_m has.

    Raises:
        UnknownNameError: `outer` names a body that the arm does not have.
    """
    mobile, *arm = [body.name for body in description.bodies]
    outer = [n for n in arm if n in description.reachability] if outer is None else list(outer)
    for name in outer:
        if name not in arm:
            raise UnknownNameError("body of the arm", name, arm)
    return ContactPairs(
        arm_base=frozenset((mobile, name) for name in outer),
        arm_arm=frozenset(
            (a, b) for (i, a), (j, b) in combinations(enumerate(arm), 2) if j - i > 1
        ),
        arm_floor=frozenset(outer),
    )


def link_contact_pairs(
    description: RobotDescription, outer: Sequence[str] | None = None
) -> ContactPairs:
    """The same pairs for the URDF's links that the bodies stand for.

    Raises:
        UnknownNameError: `outer` names a body that the arm does not have.
    """
    bodies = body_contact_pairs(description, outer)
    covers = {body.name: body.covers for body in description.bodies}

    def links(pairs: frozenset[tuple[str, str]]) -> frozenset[tuple[str, str]]:
        return frozenset(pair for a, b in pairs for pair in product(covers[a], covers[b]))

    return ContactPairs(
        arm_base=links(bodies.arm_base),
        arm_arm=links(bodies.arm_arm),
        arm_floor=frozenset(link for name in bodies.arm_floor for link in covers[name]),
    )
