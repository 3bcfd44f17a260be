"""An arm with its own URDF on a base, and names that all libraries can distinguish."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import pinocchio as pin

from app.onboarding import ROOT
from app.onboarding.read.tree import Joint, Tree
from app.robot.assets import PLANAR_JOINTS, PLANAR_LINKS

ARM_ON_BASE = "arm_on_base"
"""Name of the joint that fixes a separate arm to the base."""
_OWN_LINKS = {ROOT, f"{ROOT}_joint", "universe", *PLANAR_LINKS}
_OWN_JOINTS = {ROOT, f"{ROOT}_joint", "universe", "root_joint", "world", *PLANAR_JOINTS}


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
    reserved name the suffix `_link`. This program and pinocchio use the reserved names. A URDF may
    contain such names, but pinocchio and MuJoCo cannot distinguish them.
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
