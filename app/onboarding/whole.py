"""The robot of a request: one or two URDFs as one tree, before any shape is read.

This module imports little, so a wrong file is refused before slow imports and before
processes start.
"""

import logging
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import DbbError, RobotFileError, check_name
from app.onboarding import ROOT
from app.onboarding.read.source import locate, read_robot
from app.onboarding.read.telescope import as_one_slide
from app.onboarding.read.tree import Arm, Joint, Tree, find_arm, make_tree
from app.onboarding.request import Request, named, package_folders
from app.robot.assets import PLANAR_JOINTS, PLANAR_LINKS

_log = logging.getLogger(__name__)
ARM_ON_BASE = "arm_on_base"  # name of the joint that fixes a separate arm to the base
_OWN_LINKS = {ROOT, f"{ROOT}_joint", "universe", *PLANAR_LINKS}
_OWN_JOINTS = {ROOT, f"{ROOT}_joint", "universe", "root_joint", "world", *PLANAR_JOINTS}


@contextmanager
def one_message(doing: Callable[[], str]) -> Iterator[None]:
    """Convert any exception of a library to a `RobotFileError` of one line that names the step."""
    try:
        yield
    except DbbError:
        raise
    except Exception as error:  # pinocchio, coal, qhull, trimesh: without a common base class
        _log.debug("%s", doing(), exc_info=True)
        why = " ".join(str(error).split())[:300] or "no reason stated"
        raise RobotFileError(
            f"{doing()}: a library cannot read this robot: {type(error).__name__}: {why}; check "
            "the file with check_urdf; if it is valid, report this error together with the URDF"
        ) from error


class Whole(NamedTuple):
    """A robot with its arm, before the shapes are read."""

    tree: Tree
    base: str
    """The link of --base."""
    tip: str
    """The link of --tip."""
    arm: Arm
    """The arm between these links, before its shapes are known."""
    changes: tuple[str, ...]
    """Sentences on differences from the URDF: removed shapes, telescopes with one joint."""


@one_message(lambda: "reading the URDF")
def whole_robot(request: Request) -> Whole:
    """Read the robot from one or two files, with distinct names and one joint per telescope.

    Raises:
        RobotFileError: A file is not a URDF, or the requested links do not exist or have no arm
            between them.
        UnknownNameError: No xacro declares an argument of --xacro.
        AssetError: A package is not installed.
    """
    packages = package_folders(request.package)
    arguments = named("--xacro", request.xacro, "VALUE")
    trees, said, known = [], [], set[str]()
    for file in filter(None, (request.urdf, request.arm_urdf)):
        robot, left_out, declared = read_robot(locate(file), packages, arguments)
        trees.append(make_tree(robot))
        said += left_out
        known |= declared
    for name in arguments:
        check_name("argument of --xacro", name, known)
    tree, *arms = trees
    tip = request.tip
    for arm in arms:
        T = pin.SE3(pin.rpy.rpyToMatrix(*request.mount_rpy), np.array(request.mount_xyz))
        tree, tip = with_arm(tree, arm, request.base, arm.link(tip, "--tip"), T)
    tree, names = with_distinct_names(tree)
    base, tip = (names.get(name, name) for name in (request.base, tip))
    tree, joined = as_one_slide(tree, base, tip)
    mount = request.mount and names.get(request.mount, request.mount)
    return Whole(tree, base, tip, find_arm(tree, base, tip, mount), (*said, *joined))


def with_arm(tree: Tree, arm: Tree, base: str, tip: str, T: pin.SE3) -> tuple[Tree, str]:
    """A tree with the root of an arm fixed to the link `base`, and the new name of the arm's `tip`.

    Links and joints of the arm whose names also occur in `tree` get the prefix `arm_`. T is
    T_base_arm.

    Raises:
        RobotFileError: The link `base` does not exist.
    """
    tree.link(base, "--base")
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

    A joint with the name of a link or with a reserved name gets the suffix `_joint`, a link with a
    reserved name the suffix `_link`. This program and pinocchio use the reserved names. In a URDF a
    link and a joint may have the same name, but pinocchio and MuJoCo cannot distinguish the two.
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
