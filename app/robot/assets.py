"""Where things are: robot descriptions, meshes of installed packages, caches."""

from __future__ import annotations

import importlib.util
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


def cache_folder() -> Path:
    """Folder where borders are kept: `dbb_cache/` in a checkout, else the user's cache folder."""
    if IN_CHECKOUT:
        return SHIPPED_CACHE
    return platformdirs.user_cache_path("dbb", appauthor=False)


def robot_names() -> list[str]:
    """Names of the robots that have a description."""
    return sorted(path.parent.name for path in ASSETS.glob("*/robot.toml"))


def load_robot(name: str) -> RobotDescription:
    """The description of a robot by its name.

    Raises:
        UnknownNameError: No robot has that name; lists those that exist.
        DescriptionError: Its description does not hold.
    """
    if name not in robot_names():
        raise UnknownNameError("robot", name, robot_names())
    return load_description(ASSETS / name / "robot.toml")


def urdf_path(description: RobotDescription) -> Path:
    """The robot's URDF file.

    Raises:
        AssetError: It is not there.
    """
    if description.urdf.startswith("package://"):
        return resolve_package_uri(description.urdf)
    path = ASSETS / description.name / description.urdf
    if not path.is_file():
        raise AssetError(f"{description.name}: the URDF {path} does not exist")
    return path


def resolve_package_uri(uri: str) -> Path:
    """The file behind `package://PACKAGE/PATH`, where PACKAGE is an installed Python package.

    Raises:
        AssetError: The address is of another form, the package is not installed, the file is not in
            it, or the path leads out of it.
    """
    scheme, _, rest = uri.partition("://")
    package, _, inner = rest.partition("/")
    if scheme != "package" or not inner:
        raise AssetError(f"{uri!r} is not of the form package://PACKAGE/PATH")
    spec = importlib.util.find_spec(package) if package.isidentifier() else None
    if spec is None or not spec.submodule_search_locations:
        raise AssetError(
            f"{uri}: the package {package!r} is not installed; try: pip install {package}"
        )
    for root in map(Path, spec.submodule_search_locations):
        path = (root / inner).resolve()
        if path.is_file() and path.is_relative_to(root.resolve()):
            return path
    raise AssetError(f"{uri}: no such file in the installed package {package!r}")
