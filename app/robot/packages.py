"""Addresses of files in installed packages: `package://PACKAGE/PATH`."""

from __future__ import annotations

import importlib.util
import re
import sys
import sysconfig
from pathlib import Path

from app.errors import AssetError

_EXTRAS = ("example-robot-data", "rtbdata", "stretch_urdf")
"""Packages of the optional robots, which are installed together."""
_WITH_PYBULLET = (
    "it comes with pybullet: pip install 'dbb-mobile-manipulator[sim]', on the Pythons for which "
    "docs/install.md has it"
)


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
