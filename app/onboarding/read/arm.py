"""The arm of a URDF: its joints from the base to the tip, and the links that move as one."""

from __future__ import annotations

from typing import NamedTuple

from app.errors import RobotFileError
from app.onboarding.read.tree import Joint, Tree


class Arm(NamedTuple):
    """The arm's chain.

    Attributes:
        base: The base's link.
        tip: The link that carries the end-effector.
        mount: Link at whose origin the arm stands.
        joints: The joints that move it, from the base outwards.
        base_links: All that is fixed to the base or hangs on it, but not the arm; wheels too.
        segments: (n_m + 1) links that move as one: what is fixed below the first joint, then what
            each joint carries, joints beside the chain (fingers) held at zero.
    """

    base: str
    tip: str
    mount: str
    joints: tuple[Joint, ...]
    base_links: tuple[str, ...]
    segments: tuple[tuple[str, ...], ...]


def find_arm(tree: Tree, base: str, tip: str, mount: str | None = None) -> Arm:
    """The arm between two links.

    Args:
        tree: The robot.
        base: Link that moves with the base.
        tip: Link that carries the end-effector.
        mount: Link at whose origin the arm stands; by default the one that carries its first joint.

    Raises:
        RobotFileError: A link is not there, or no joint moves between them; names the option.
    """
    tree.link(base, "--base")
    tree.link(tip, "--tip")
    chain = tree.chain(base, tip)
    _nothing_above(tree, base)
    joints = [joint for joint in chain if joint.moves]
    if not joints:
        raise RobotFileError(f"--tip: no joint moves {tip!r} against --base {base!r}")
    first = joints[0]
    on_chain = [joint.parent for joint in chain]
    fixed_part = on_chain[: on_chain.index(first.parent) + 1]
    if mount is not None:
        tree.link(mount, "--mount")
        if mount not in fixed_part and mount != first.child:
            raise RobotFileError(
                f"--mount: {mount!r} is not between --base and the first joint {first.name!r}; "
                f"choose from: {', '.join(fixed_part[1:]) or first.child}"
            )
    else:
        mount = first.parent if first.parent != base else first.child
    segments = [tuple(tree.below(mount, without=[first.name])) if mount in fixed_part[1:] else ()]
    for joint, following in zip(joints, [*joints[1:], None], strict=True):
        without = [] if following is None else [following.name]
        segments.append(tuple(tree.below(joint.child, without=without)))
    cut = [first.name, *([tree.joint_of[mount].name] if segments[0] else [])]
    base_links = tuple(tree.below(base, without=cut))
    return Arm(base, tip, mount, tuple(joints), base_links, tuple(segments))


def rigid_to_base(tree: Tree, arm: Arm) -> list[str]:
    """Links of the base that do not move against it."""
    return [link for link in tree.rigid(arm.base) if link in arm.base_links]


def _nothing_above(tree: Tree, base: str) -> None:
    """What lies between the root and the base may be frames, and nothing else may hang there."""
    link = base
    while link in tree.joint_of:
        parent = tree.joint_of[link].parent
        beside = [j.child for j in tree.children(parent) if j.child != link]
        solid = any(tree.links[parent].findall(tag) for tag in ("collision", "visual"))
        if beside or solid:
            what = f"{', '.join(beside)} hang on" if beside else "there are shapes on"
            raise RobotFileError(
                f"--base: {what} {parent!r}, above {base!r}: they would be lost; "
                f"give --base {parent}"
            )
        link = parent
