"""Telescopes: slides of an arm that follow one another (`<mimic>`) become one slide."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import accumulate
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from app.onboarding.read.tree import MOVING, Joint, make_tree


def as_one_slide(robot: Element, base: str, tip: str) -> list[str]:
    """Join the telescopes of a robot's arm, in its XML; returns a sentence on each.

    The leading joint then moves the last part, by the sum of all travels. The parts between
    are children of the last one, on slides that let them reach all their places.
    """
    tree = make_tree(robot)
    if not {base, tip} <= tree.links.keys():
        return []  # a later check reports this
    chain = tree.chain(base, tip)
    elements = {str(each.get("name")): each for each in robot.findall("joint")}
    said = []
    for first, last, parts in _telescopes(chain):
        run = chain[chain.index(first) : chain.index(last) + 1]
        leader = next(joint for joint in parts if joint.mimic is None)
        _join(elements, run, parts, leader)
        said.append(
            f"{', '.join(joint.name for joint in parts)} slide as one (<mimic>): {leader.name} is "
            "the sum of their travels here"
        )
    return said


def _telescopes(chain: Sequence[Joint]) -> Iterator[tuple[Joint, Joint, list[Joint]]]:
    """First and last joint, and all joints, of each run of slides of one motor along a line."""
    moving = [joint for joint in chain if joint.kind in MOVING]
    for leader in [joint for joint in moving if joint.mimic is None]:
        own = [j for j in moving if j == leader or (j.mimic and j.mimic[0] == leader.name)]
        at = [moving.index(joint) for joint in own]
        together = at == list(range(at[0], at[0] + len(at)))
        if len(own) > 1 and together and all(joint.kind == "prismatic" for joint in own):
            yield own[0], own[-1], own


def _join(
    elements: dict[str, Element], run: Sequence[Joint], parts: Sequence[Joint], leader: Joint
) -> None:
    factors = [1.0 if joint.mimic is None else joint.mimic[1] for joint in parts]
    offsets = {joint.name: joint.mimic[2] if joint.mimic else 0.0 for joint in parts}
    ways, total = [*accumulate(factors)], sum(factors)
    places, T = {}, pin.SE3.Identity()
    for joint in run:
        T = T * (joint.motion(offsets[joint.name]) if joint in parts else joint.T_parent_child)
        places[joint.name] = T
    end = places[parts[-1].name]
    along = places[parts[0].name].rotation @ parts[0].axis * np.sign(total)
    low, high, total = leader.lower or 0.0, leader.upper or 0.0, abs(total)
    old = elements[leader.name].find("limit")
    effort, speed = (float((old.get(key) if old is not None else None) or 0.0) for key in _MOTOR)
    names = iter([leader.name, *(joint.name for joint in parts if joint != leader)])
    limits = {"lower": total * low, "upper": total * high}
    limits |= {"effort": effort / total, "velocity": speed * total}
    _write(elements[next(names)], run[0].parent, parts[-1].child, end, along, limits)
    for joint, way in zip(parts[:-1], ways[:-1], strict=True):
        ends = sorted((abs(way) - total) * q for q in (low, high))
        limits = {"lower": ends[0], "upper": ends[1], "effort": 0.0, "velocity": 0.0}
        between = end.actInv(places[joint.name])
        _write(elements[next(names)], parts[-1].child, joint.child, between, along, limits, end)


_MOTOR = ("effort", "velocity")


def _write(
    element: Element,
    parent: str,
    child: str,
    T: pin.SE3,
    along: np.ndarray,
    limits: dict[str, float],
    end: pin.SE3 | None = None,
) -> None:
    """A slide at T in its parent; `along` (3,) is in the frame of the first parent."""
    name = str(element.get("name"))
    element.clear()
    element.attrib |= {"name": name, "type": "prismatic"}
    SubElement(element, "parent", link=parent)
    SubElement(element, "child", link=child)
    xyz, rpy = (" ".join(map(repr, map(float, v))) for v in (T.translation, _rpy(T)))
    SubElement(element, "origin", xyz=xyz, rpy=rpy)
    R = T.rotation if end is None else end.rotation @ T.rotation
    SubElement(element, "axis", xyz=" ".join(map(repr, map(float, R.T @ along))))
    SubElement(element, "limit", {key: repr(float(value)) for key, value in limits.items()})


def _rpy(T: pin.SE3) -> np.ndarray:
    return pin.rpy.matrixToRpy(T.rotation)
