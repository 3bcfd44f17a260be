"""Where things are: robot descriptions, their URDFs with meshes, and caches.

The same text of a URDF is for pinocchio and, with a planar root, for pybullet.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from xml.etree import ElementTree

import platformdirs

from app.errors import AssetError, DescriptionError, UnknownNameError
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


PLANAR_JOINTS = ("planar_x", "planar_y", "planar_yaw")
"""Joints of the planar root that `planar_urdf` puts under the robot."""

_PLANAR_ROOT = """
  <link name="planar_world">{zero}</link>
  <link name="planar_x_link">{zero}</link>
  <link name="planar_y_link">{zero}</link>
  <joint name="planar_x" type="prismatic">
    <parent link="planar_world"/><child link="planar_x_link"/><axis xyz="1 0 0"/>
    <limit lower="-1e6" upper="1e6" effort="1e6" velocity="1e3"/>
  </joint>
  <joint name="planar_y" type="prismatic">
    <parent link="planar_x_link"/><child link="planar_y_link"/><axis xyz="0 1 0"/>
    <limit lower="-1e6" upper="1e6" effort="1e6" velocity="1e3"/>
  </joint>
  <joint name="planar_yaw" type="revolute">
    <parent link="planar_y_link"/><child link="{root}"/><axis xyz="0 0 1"/>
    <limit lower="-1e6" upper="1e6" effort="1e6" velocity="1e3"/>
  </joint>
"""
_ZERO_INERTIAL = (
    '<inertial><mass value="0"/>'
    '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
)


def resolved_urdf(description: RobotDescription) -> str:
    """The robot's URDF with every mesh by its absolute path, and an inertia for each link.

    A link without one has none: pybullet would take it for 1 kg.

    Raises:
        AssetError: The URDF or a mesh that it refers to is not there.
        DescriptionError: The URDF is not well-formed XML.
    """
    path = urdf_path(description)
    tree = _read(path)
    for mesh in tree.iter("mesh"):
        reference = mesh.get("filename", "")
        if reference and not reference.startswith("/"):
            mesh.set("filename", str(_mesh(reference, path.parent)))
    return ElementTree.tostring(tree, encoding="unicode")


def bare_urdf(description: RobotDescription) -> str:
    """The robot's URDF without shapes, so without meshes that may not be installed.

    Raises:
        AssetError: The URDF is not there.
        DescriptionError: The URDF is not well-formed XML.
    """
    tree = _read(urdf_path(description))
    for link in tree.iterfind("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    return ElementTree.tostring(tree, encoding="unicode")


def _read(path: Path) -> ElementTree.Element:
    """A URDF with an inertia for each link."""
    try:
        tree = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    except ElementTree.ParseError as error:
        raise DescriptionError(f"{path}: not well-formed: {error}") from None
    for link in tree.iterfind("link"):
        if link.find("inertial") is None:
            link.append(ElementTree.fromstring(_ZERO_INERTIAL))
    return tree


def _mesh(reference: str, folder: Path) -> Path:
    """A mesh of an installed package, or one in the URDF's own folder."""
    if "://" in reference:
        return resolve_package_uri(reference)
    path = (folder / reference).resolve()
    if not path.is_file() or not path.is_relative_to(folder.resolve()):
        raise AssetError(f"{folder.name}: no mesh {reference!r} in the folder of the URDF")
    return path


def planar_urdf(description: RobotDescription) -> str:
    """The resolved URDF on a root of two prismatic joints and a revolute one: x, y, yaw.

    pybullet knows no planar joint; in pinocchio the same root is `JointModelPlanar`.
    """
    text = resolved_urdf(description)
    planar = _PLANAR_ROOT.format(zero=_ZERO_INERTIAL, root=root_link(text))
    return text.replace("</robot>", planar + "</robot>")


def floats(text: str, count: int) -> list[float] | None:
    """The numbers of an attribute; None unless they are so many, and finite."""
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        return None
    return values if len(values) == count and all(map(math.isfinite, values)) else None


def root_link(urdf: str) -> str:
    """Name of the link that no joint has as its child."""
    tree = ElementTree.fromstring(urdf)
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    return next(
        str(link.get("name")) for link in tree.iterfind("link") if link.get("name") not in children
    )
