"""Where things are: robot descriptions and caches."""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

from app.errors import AssetError, UnknownNameError
from app.robot.description import RobotDescription, load_description
from app.robot.packages import resolve_package_uri

_PACKAGE = Path(__file__).resolve().parent.parent
_PROJECT = _PACKAGE.parent
IN_CHECKOUT = (_PROJECT / "pyproject.toml").is_file() and (_PROJECT / "robot_assets").is_dir()
ASSETS = (_PROJECT if IN_CHECKOUT else _PACKAGE) / "robot_assets"
"""Folder of the robot descriptions, in a checkout or inside the installed package."""
SHIPPED_CACHE = (_PROJECT if IN_CHECKOUT else _PACKAGE) / "dbb_cache"
"""Folder of the borders that ship with the project; only read."""


def cache_folder() -> Path:
    """Folder where borders are kept: `dbb_cache/` in a checkout, else the user's cache folder."""
    if IN_CHECKOUT:
        return SHIPPED_CACHE
    return platformdirs.user_cache_path("dbb", appauthor=False)


def user_robots() -> Path:
    """Folder of the user's own robots: `$DBB_ROBOTS`, else `robots` in the user's data folder."""
    named = os.environ.get("DBB_ROBOTS")
    return Path(named) if named else platformdirs.user_data_path("dbb", appauthor=False) / "robots"


def robot_names() -> list[str]:
    """Names of the robots that have a description, those of the user included."""
    found = {path.parent.name for top in _tops() for path in top.glob("*/robot.toml")}
    return sorted(name for name in found if not name.startswith("."))  # one that is being made


def robot_folder(name: str) -> Path:
    """Folder of a robot's description; of two of the same name, the one that ships."""
    folders = [top / name for top in _tops()]
    return next((each for each in folders if (each / "robot.toml").is_file()), folders[0])


def _tops() -> tuple[Path, Path]:
    return ASSETS, user_robots()


def load_robot(name: str) -> RobotDescription:
    """The description of a robot by its name.

    Raises:
        UnknownNameError: No robot has that name; lists those that exist.
        DescriptionError: Its description does not hold.
    """
    if name not in robot_names():
        raise UnknownNameError("robot", name, robot_names())
    return load_description(robot_folder(name) / "robot.toml")


def urdf_path(description: RobotDescription) -> Path:
    """The robot's URDF file.

    Raises:
        AssetError: It is not there.
    """
    if description.urdf.startswith("package://"):
        return resolve_package_uri(description.urdf)
    path = robot_folder(description.name) / description.urdf
    if not path.is_file():
        raise AssetError(f"{description.name}: the URDF {path} does not exist")
    return path
