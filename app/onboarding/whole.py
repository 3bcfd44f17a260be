"""The robot of a request: one or two URDFs as one tree, before any shape is read.

This module imports little, so a wrong file is refused before slow imports and before processes.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import DbbError, RobotFileError
from app.onboarding.compose import with_arm, with_distinct_names
from app.onboarding.read.source import locate, read_robot
from app.onboarding.read.telescope import as_one_slide
from app.onboarding.read.tree import Arm, Tree, find_arm, make_tree
from app.onboarding.request import Request, named, package_folders

_log = logging.getLogger(__name__)


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
        RobotFileError: A file is no URDF, or the links of the request do not exist or have no arm
            between them.
        AssetError: A package is not installed.
    """
    packages = package_folders(request.package)
    arguments = named("--xacro", request.xacro, "VALUE")
    trees, said = [], []
    for file in filter(None, (request.urdf, request.arm_urdf)):
        robot, left_out = read_robot(locate(file), packages, **arguments)
        trees.append(make_tree(robot))
        said += left_out
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
