"""The robot of a request: one or two URDFs as one tree, before any shape is read.

This module imports little, so that a wrong file is refused before slow imports.
"""

import logging
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import accumulate
from operator import mul
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import DbbError, RobotFileError, check_name
from app.onboarding import ROOT
from app.onboarding.read.source import locate, read_robot
from app.onboarding.read.tree import MOVING, PARALLEL, Arm, Joint, Tree, find_arm, make_tree
from app.onboarding.request import Request, named, package_folders
from app.robot.assets import PLANAR_JOINTS, PLANAR_LINKS

_log = logging.getLogger(__name__)
ARM_ON_BASE = "arm_on_base"  # name of the joint that fixes a separate arm to the base
_OWN_LINKS = {ROOT, f"{ROOT}_joint", "universe", *PLANAR_LINKS}
_OWN_JOINTS = {ROOT, f"{ROOT}_joint", "universe", "root_joint", "world", *PLANAR_JOINTS}


@contextmanager
def one_message(doing: Callable[[], str]) -> Iterator[None]:
    """Convert any error but a `DbbError` to a `RobotFileError` with the file, or else `doing`."""
    try:
        yield
    except DbbError:
        raise
    except Exception as error:  # pinocchio, coal, qhull, trimesh: without a common base class
        if isinstance(error, OSError) and error.filename:
            raise RobotFileError(f"{error.filename}: cannot be read: {error.strerror}") from None
        _log.debug("%s", doing(), exc_info=True)
        why = " ".join(str(error).split())[:300] or "no reason stated"
        why = f"a library cannot read this robot: {type(error).__name__}: {why}"
        helps = "check the file with check_urdf; if it is valid, report this error and the URDF"
        raise RobotFileError(f"{doing()}: {why}; {helps}") from error


class Whole(NamedTuple):
    """A robot with its arm, before the shapes are read."""

    tree: Tree
    arm: Arm
    changes: tuple[str, ...]
    """Sentences on differences from the URDF: removed shapes, telescopes with one joint."""


@one_message(lambda: "reading the URDF")
def whole_robot(request: Request) -> Whole:
    """Read the robot from one or two files, with distinct names and one joint per telescope.

    A RobotFileError is raised if a file is no valid robot, an option names no link, or no arm is
    between --base and --tip; an UnknownNameError if no xacro declares or uses an argument of
    --xacro; and an AssetError if a `package://` file of the request does not exist.
    """
    packages = package_folders(request.package)
    arguments = named("--xacro", request.xacro, "VALUE")
    trees, said, known = [], [], set[str]()
    for file in filter(None, (request.urdf, request.arm_urdf)):
        robot, left_out, declared = read_robot(locate(file), packages, arguments)
        trees.append(make_tree(robot))
        said += left_out
        known.update(declared)
    for name in arguments:
        check_name("argument of --xacro", name, known)
    tree, *arms = trees
    tip = request.tip
    for arm in arms:
        T = pin.SE3(pin.rpy.rpyToMatrix(*request.mount_rpy), np.array(request.mount_xyz))
        arm.check_link(tip, "--tip")
        tree, tip = with_arm(tree, arm, request.base, tip, T)
    tree, names = with_distinct_names(tree)
    base, tip = (names.get(name, name) for name in (request.base, tip))
    tree, joined = as_one_slide(tree, base, tip)
    mount = request.mount and names.get(request.mount, request.mount)
    return Whole(tree, find_arm(tree, base, tip, mount), (*said, *joined))


def with_arm(tree: Tree, arm: Tree, base: str, tip: str, T: pin.SE3) -> tuple[Tree, str]:
    """A tree with the root of an arm fixed to the link `base`, and the new name of the arm's `tip`.

    Links and joints of the arm whose names also occur in `tree` get the prefix `arm_`. T is
    T_base_root, the pose of the arm's root. A missing link `base` raises a `RobotFileError`.
    """
    tree.check_link(base, "--base")
    tree = _renamed(tree, {}, _distinct(tree.joints, {ARM_ON_BASE}, tree.joints, "{}_joint"))
    links, joints = (
        _distinct(own, names, {*own, *names}, "arm_{}")
        for own, names in ((arm.links, tree.links), (arm.joints, {*tree.joints, ARM_ON_BASE}))
    )
    arm = _renamed(arm, links, joints)
    joint = Joint(ARM_ON_BASE, "fixed", base, arm.root, T)
    joints_of_both = tree.joints | arm.joints | {ARM_ON_BASE: joint}
    return Tree(tree.links | arm.links, joints_of_both), links.get(tip, tip)


def with_distinct_names(tree: Tree) -> tuple[Tree, dict[str, str]]:
    """The tree with distinct names, and the new names of its renamed links by the old ones.

    A joint with the name of a link gets the suffix `_joint`, because pinocchio and MuJoCo cannot
    distinguish the two. Names that this program or pinocchio uses are reserved: a joint with a
    reserved name also gets the suffix `_joint`, and a link gets the suffix `_link`.
    """
    links = _distinct(tree.links, _OWN_LINKS, {*tree.links, *tree.joints}, "{}_link")
    foreign = {links.get(name, name) for name in tree.links} | _OWN_JOINTS
    joints = _distinct(tree.joints, foreign, {*foreign, *tree.joints}, "{}_joint")
    return _renamed(tree, links, joints), links


def _distinct(
    names: Collection[str], foreign: Collection[str], taken: Collection[str], form: str
) -> dict[str, str]:
    """New names of the form `form`, not among `taken`, for all names that are also in `foreign`."""
    renamed: dict[str, str] = {}
    for name in names:
        if name in foreign:
            new = form.format(name)
            while new in taken or new in renamed.values():
                new += "_"
            renamed[name] = new
    return renamed


def _renamed(tree: Tree, links: Mapping[str, str], joints: Mapping[str, str]) -> Tree:
    """The tree with new names of some links and joints, by the old names."""
    found = {}
    for name, joint in tree.joints.items():
        parent, child = (links.get(end, end) for end in (joint.parent, joint.child))
        mimic = joint.mimic and (joints.get(joint.mimic[0], joint.mimic[0]), *joint.mimic[1:])
        new = joints.get(name, name)
        found[new] = joint._replace(name=new, parent=parent, child=child, mimic=mimic)
    own = {links.get(name, name): link for name, link in tree.links.items()}
    return replace(tree, links=own, joints=found)


def as_one_slide(tree: Tree, base: str, tip: str) -> tuple[Tree, list[str]]:
    """A tree with one joint for each telescope from `base` to `tip`; a sentence on each telescope.

    A telescope has one independent prismatic joint, the leader, and parallel ones that follow it
    (`<mimic>`), with only fixed joints between them. In the new tree, the leader alone moves the
    last part, by the sum of all positions. Each other part becomes a child of the last part, on an
    independent prismatic joint, whose limits include all positions of the part relative to it.
    """
    if not {base, tip} <= tree.links.keys():
        return tree, []  # `find_arm` reports this
    joints, said, chain = dict(tree.joints), [], tree.chain(base, tip)
    moving = [joint for joint in chain if joint.kind in MOVING]
    for leader in [joint for joint in moving if joint.mimic is None]:
        parts = [j for j in moving if j == leader or (j.mimic and j.mimic[0] == leader.name)]
        run = chain[chain.index(parts[0]) : chain.index(parts[-1]) + 1]
        together = parts == [joint for joint in run if joint in moving]
        if len(parts) == 1 or not together or {joint.kind for joint in parts} != {"prismatic"}:
            continue
        offsets = [joint.mimic[2] if joint in parts and joint.mimic else 0.0 for joint in run]
        motions = [joint.motion(q) for joint, q in zip(run, offsets, strict=True)]
        names = [joint.name for joint in run]
        poses = dict(zip(names, accumulate(motions, mul), strict=True))
        places = [poses[joint.name] for joint in parts]
        axes = [T.rotation @ joint.axis for T, joint in zip(places, parts, strict=True)]
        cosines = [float(axes[0] @ axis) for axis in axes]
        factors = (joint.mimic[1] if joint.mimic else 1.0 for joint in parts)
        sums = [*accumulate(k * f for k, f in zip(map(round, cosines), factors, strict=True))]
        if min(map(abs, cosines)) <= PARALLEL or sums[-1] == 0.0:
            continue
        joints |= {joint.name: joint for joint in _joined(tree, leader, parts, places, sums)}
        merged = f"{', '.join(joint.name for joint in parts)} follow one another (<mimic>)"
        total = f"the position of {leader.name} is now the sum of their positions"
        said.append(f"{merged} and become one joint: {total}")
    return replace(tree, joints=joints), said


def _joined(
    tree: Tree,
    leader: Joint,
    parts: Sequence[Joint],
    places: Sequence[pin.SE3],
    sums: Sequence[float],
) -> Iterator[Joint]:
    """The changed joints: those of a telescope, and other joints that follow one of its `parts`.

    `places` are the poses of the parts relative to the parent of the first one. `sums` are the
    total travels of the parts along the axis of the first one, for a unit travel of the leader.
    """
    low, high = leader.lower or 0.0, leader.upper or 0.0
    total, end, last = abs(sums[-1]), places[-1], parts[-1].child
    own = {joint.name: joint.mimic or (leader.name, 1.0, 0.0) for joint in parts}
    for joint in tree.joints.values():
        if joint.name not in own and joint.mimic is not None and joint.mimic[0] in own:
            name, factor, offset = joint.mimic
            _, part_factor, part_offset = own[name]
            mimic = leader.name, factor * part_factor / total, offset + factor * part_offset
            yield joint._replace(mimic=mimic)
    along = places[0].rotation @ parts[0].axis * np.sign(sums[-1])
    yield leader._replace(
        parent=parts[0].parent,
        child=last,
        T_parent_child=end,
        axis=end.rotation.T @ along,
        lower=total * low,
        upper=total * high,
        effort=(leader.effort or 0.0) / total,
        velocity=(leader.velocity or 0.0) * total,
    )
    names = [joint.name for joint in parts if joint is not leader]
    free = leader._replace(parent=last, effort=0.0, velocity=0.0)
    for name, part, place, factor in zip(names, parts[:-1], places[:-1], sums[:-1], strict=True):
        lower, upper = sorted((factor * np.sign(sums[-1]) - total) * q for q in (low, high))
        axis, T = place.rotation.T @ along, end.actInv(place)
        yield free._replace(
            name=name, child=part.child, T_parent_child=T, axis=axis, lower=lower, upper=upper
        )
