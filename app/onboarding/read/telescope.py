"""Telescopes: prismatic joints of an arm that follow one another become one prismatic joint."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import accumulate

import numpy as np
import pinocchio as pin

from app.onboarding.read.tree import MOVING, PARALLEL, Joint, Tree


def as_one_slide(tree: Tree, base: str, tip: str) -> tuple[Tree, list[str]]:
    """A tree in which each telescope between two links has one joint, and a sentence on each one.

    The links are `base` and `tip`. A telescope has one independent joint and other joints that
    follow it (`<mimic>`). In the new tree, this independent joint alone moves the last part, by the
    sum of all positions. The parts before the last one become children of the last one, on
    prismatic joints whose limits include all their positions.

    Raises:
        RobotFileError: `tip` is not a descendant of `base`.
    """
    if not {base, tip} <= tree.links.keys():
        return tree, []  # `find_arm` reports this
    joints, said = dict(tree.joints), []
    chain = tree.chain(base, tip)
    for run, parts in _telescopes(chain):
        leader, *others = sorted(parts, key=lambda joint: joint.mimic is not None)
        led = _followers(tree, parts, leader.name, abs(_sums(run, parts)[-1]))
        joints |= {joint.name: joint for joint in (*led, *_joined(run, parts, leader, others))}
        said.append(
            f"{', '.join(joint.name for joint in parts)} follow one another (<mimic>) and become "
            f"one joint: the position of {leader.name} is now the sum of their positions"
        )
    return replace(tree, joints=joints), said


def _telescopes(chain: list[Joint]) -> Iterator[tuple[list[Joint], list[Joint]]]:
    """For each telescope: all joints from its first to its last part, and the joints of its parts.

    The joints of the parts are prismatic and parallel. One of them leads, and the others follow it.
    Only fixed joints can be between them.
    """
    moving = [joint for joint in chain if joint.kind in MOVING]
    for leader in [joint for joint in moving if joint.mimic is None]:
        own = [j for j in moving if j == leader or (j.mimic and j.mimic[0] == leader.name)]
        first = moving.index(own[0])
        together = own == moving[first : first + len(own)]
        if len(own) > 1 and together and {j.kind for j in own} == {"prismatic"}:
            run = chain[chain.index(own[0]) : chain.index(own[-1]) + 1]
            parallel = all(abs(share) > PARALLEL for share in _directions(run, own))
            if parallel and _sums(run, own)[-1] != 0.0:
                yield run, own


def _directions(run: Sequence[Joint], parts: Sequence[Joint]) -> list[float]:
    """The cosines of the angles between the axis of the first part and those of all parts."""
    found, R = [], np.eye(3)
    for joint in run:
        R = R @ joint.T_parent_child.rotation
        if joint in parts:
            found.append(R @ joint.axis)
    return [float(found[0] @ axis) for axis in found]


def _sums(run: Sequence[Joint], parts: Sequence[Joint]) -> list[float]:
    """The travel of each part along the axis of the first part, for a unit travel of the leader."""
    factors = (1.0 if joint.mimic is None else joint.mimic[1] for joint in parts)
    directions = map(round, _directions(run, parts))
    return [*accumulate(k * f for k, f in zip(directions, factors, strict=True))]


def _followers(tree: Tree, parts: Sequence[Joint], leader: str, total: float) -> Iterator[Joint]:
    """Joints outside a telescope that follow one of its parts.

    In the new tree they follow the leader, whose new position is `total` times its former position.
    """
    own = {joint.name: joint.mimic or (leader, 1.0, 0.0) for joint in parts}
    for joint in tree.joints.values():
        if joint.name not in own and joint.mimic is not None and joint.mimic[0] in own:
            name, factor, offset = joint.mimic
            _, part_factor, part_offset = own[name]
            mimic = leader, factor * part_factor / total, offset + factor * part_offset
            yield joint._replace(mimic=mimic)


def _joined(
    run: Sequence[Joint], parts: Sequence[Joint], leader: Joint, others: Sequence[Joint]
) -> Iterator[Joint]:
    """The leader as the only joint of the chain, and the other joints on the last part.

    `run` has all joints from the first part to the last, including fixed ones.
    """
    low, high = leader.lower or 0.0, leader.upper or 0.0
    sums = _sums(run, parts)
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
        lower, upper = sorted((factor * np.sign(sums[-1]) - total) * q for q in (low, high))
        axis, T = place.rotation.T @ along, end.actInv(place)
        yield free._replace(
            name=joint.name, child=part.child, T_parent_child=T, axis=axis, lower=lower, upper=upper
        )
