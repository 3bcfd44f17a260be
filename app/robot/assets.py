"""Where things are: robot descriptions, meshes of installed packages, caches."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import sysconfig
from pathlib import Path

import platformdirs

from app.errors import AssetError, UnknownNameError
from app.robot.description import RobotDescription, load_description

_PACKAGE = Path(__file__).resolve().parent.parent
_PROJECT = _PACKAGE.parent
IN_CHECKOUT = (_PROJECT / "pyproject.toml").is_file() and (_PROJECT / "robot_assets").is_dir()
ASSETS = (_PROJECT if IN_CHECKOUT else _PACKAGE) / "robot_assets"
"""Folder of the robot descriptions, in a checkout or inside the installed package."""
SHIPPED_CACHE = (_PROJECT if IN_CHECKOUT else _PACKAGE) / "dbb_cache"
"""Folder of the borders that ship with the project; only read."""

_EXTRAS = ("example-robot-data", "rtbdata", "stretch_urdf")
"""Packages of the optional robots, which are installed together."""
_WITH_PYBULLET = (
    "it comes with pybullet: pip install 'dbb-mobile-manipulator[sim]', on the Pythons for which "
    "docs/install.md has it"
)


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


def resolve_package_uri(uri: str) -> Path:
    """The file behind `package://PACKAGE/PATH`, where PACKAGE is an installed package.

    That is a Python package, or one that a wheel put under its `share` folder, as those of ROS are.

    Raises:
        AssetError: The address is of another form, the package is not installed, the file is not in
            it, or the path leads out of it.
    """
    scheme, _, rest = uri.partition("://")
    package, _, inner = rest.partition("/")
    if scheme != "package" or not inner:
        raise AssetError(f"{uri!r} is not of the form package://PACKAGE/PATH")
    roots = package_roots(package)
    if not roots:
        # No other name is advised to be installed: it stands in a file, and anybody may own it.
        how = "; try: pip install '.[robots]'" if package in _EXTRAS else ""
        how = f"; {_WITH_PYBULLET}" if package == "pybullet_data" else how
        raise AssetError(f"{uri}: the package {package!r} is not installed{how}")
    for root in roots:
        path = (root / inner).resolve()
        if path.is_file() and path.is_relative_to(root.resolve()):
            return path
    raise AssetError(f"{uri}: no such file in the installed package {package!r}")


def package_roots(package: str) -> list[Path]:
    """Folders of an installed package: a Python package's own, then those of its share."""
    spec = importlib.util.find_spec(package) if package.isidentifier() else None
    roots = [Path(root) for root in (spec.submodule_search_locations if spec else None) or ()]
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", package):
        roots += [share / package for share in share_folders() if (share / package).is_dir()]
    return roots


def share_folders() -> list[Path]:
    """Folders in which wheels keep packages that are not Python's: `share` of their prefix."""
    libraries = {Path(sysconfig.get_path(kind)) for kind in ("purelib", "platlib")}
    prefixes = [*(library / "cmeel.prefix" for library in sorted(libraries)), Path(sys.prefix)]
    return [share for prefix in prefixes if (share := prefix / "share").is_dir()]
