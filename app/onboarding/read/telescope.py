"""Telescopes: prismatic joints of an arm that follow one another become one prismatic joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pinocchio as pin

from app.onboarding.read.tree import MOVING, Joint, Tree


def as_one_slide(tree: Tree, base: str, tip: str) -> tuple[Tree, list[str]]:
    """A tree with joined telescopes between the links `base` and `tip`, and a sentence on each one.

    A telescope has one independent joint and other joints that follow it (`<mimic>`). Afterwards
    this independent joint alone moves the last part, by the sum of all positions. The parts before
    the last one become its children, on prismatic joints whose limits include all their positions.

    Raises:
        RobotFileError: `tip` is not a descendant of `base`.
    """
    if not {base, tip} <= tree.links.keys():
        return tree, []  # `find_arm` reports this
    joints, said = dict(tree.joints), []
    chain = tree.chain(base, tip)
    for parts in _telescopes(chain):
        run = chain[chain.index(parts[0]) : chain.index(parts[-1]) + 1]
        leader, *others = sorted(parts, key=lambda joint: joint.mimic is not None)
        joints |= {joint.name: joint for joint in _joined(run, parts, leader, others)}
        said.append(
            f"{', '.join(joint.name for joint in parts)} follow one another (<mimic>) and become "
            f"one joint: the position of {leader.name} is now the sum of their positions"
        )
    return replace(tree, joints=joints), said


def _telescopes(chain: Sequence[Joint]) -> Iterator[list[Joint]]:
    """The joints of each telescope: consecutive prismatic joints that one of them leads."""
    moving = [joint for joint in chain if joint.kind in MOVING]
    for leader in [joint for joint in moving if joint.mimic is None]:
        own = [j for j in moving if j == leader or (j.mimic and j.mimic[0] == leader.name)]
        first = moving.index(own[0])
        together = own == moving[first : first + len(own)]
        extends = sum(joint.mimic[1] if joint.mimic else 1.0 for joint in own) != 0.0
        if len(own) > 1 and together and extends and {j.kind for j in own} == {"prismatic"}:
            yield own


def _joined(
    run: Sequence[Joint], parts: Sequence[Joint], leader: Joint, others: Sequence[Joint]
) -> Iterator[Joint]:
    """The leader as the only joint of the chain, and the other joints on the last part.

    `run` has all joints from the first part to the last, including fixed ones.
    """
    low, high = leader.lower or 0.0, leader.upper or 0.0
    sums = [*accumulate(1.0 if joint.mimic is None else joint.mimic[1] for joint in parts)]
    places, T = {}, pin.SE3.Identity()
    for joint in run:
        T = T * joint.motion(joint.mimic[2] if joint in parts and joint.mimic else 0.0)
        places[joint.name] = T
    total, end, last = abs(sums[-1]), places[parts[-1].name], parts[-1].child
    along = places[parts[0].name].rotation @ parts[0].axis * np.sign(sums[-1])
    yield leader._replace(
        parent=run[0].parent,
        child=last,
        T_parent_child=end,
        axis=end.rotation.T @ along,
        lower=total * low,
        upper=total * high,
        effort=(leader.effort or 0.0) / total,
        velocity=(leader.velocity or 0.0) * total,
    )
    free = leader._replace(parent=last, effort=0.0, velocity=0.0)
    for joint, part, factor in zip(others, parts[:-1], sums[:-1], strict=True):
        place = places[part.name]
        lower, upper = sorted((abs(factor) - total) * q for q in (low, high))
        axis, T = place.rotation.T @ along, end.actInv(place)
        yield free._replace(
            name=joint.name, child=part.child, T_parent_child=T, axis=axis, lower=lower, upper=upper
        )
