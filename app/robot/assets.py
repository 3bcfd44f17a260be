"""Files of robots: folders, URDFs, meshes, packages with meshes, and the folder of borders."""

import codecs
import importlib.util
import math
import os
import re
import sys
import sysconfig
from collections.abc import Sized
from contextlib import suppress
from itertools import pairwise
from os.path import isdir, isfile  # False also for a name that is too long for a file
from pathlib import Path
from typing import NoReturn, Protocol
from xml.etree import ElementTree
from xml.parsers import expat

import platformdirs

from app.errors import AssetError, DescriptionError, RobotFileError, UnknownNameError, check_name
from app.strict import COMMENT, content_of, placeholder
from app.system import cache_folders, home_expanded, home_folder, is_writable

_PACKAGE = Path(__file__).resolve().parent.parent
_PROJECT = _PACKAGE.parent
IN_CHECKOUT = (_PROJECT / "pyproject.toml").is_file() and (_PROJECT / "robot_assets").is_dir()
ASSETS = (_PROJECT if IN_CHECKOUT else _PACKAGE) / "robot_assets"
"""Folder of the delivered robots, in a checkout or inside the installed package."""
SHIPPED_CACHE = (_PROJECT if IN_CHECKOUT else _PACKAGE) / "dbb_cache"
"""Folder of the delivered borders; in a writable checkout also of new ones (`cache_folder`)."""
_MAX_ELEMENTS = 30_000  # [-] largest number of elements of an XML file; large URDFs have thousands
_MAX_JOINTS = 200  # [-] largest number of moving joints of a robot; large robots have 60
_MAX_ATTRIBUTES = 100  # [-] largest number per element; some parsers compare each with all others
_DEEPEST = 100  # [-] deepest nesting of elements
_PART = 1 << 14  # [bytes] length of the two parts of a mesh file that are searched for damage
# Found at the end of an undamaged text file; in an OBJ file, no vertex follows the last face.
_ENDS = {".stl": b"endsolid", ".dae": b"collada>", ".obj": rb"[\r\n][ \t]*f\s(?!.*[\r\n][ \t]*v)"}
_PIP = "pip install 'dbb-mobile-manipulator"
_WITH_PYBULLET = f"it comes with pybullet: {_PIP}[sim]', on the Pythons that docs/install.md lists"
_OPTIONAL = ("example-robot-data", "rtbdata", "stretch_urdf")  # packages of the optional robots
_ADVICE = dict.fromkeys(_OPTIONAL, f"try: {_PIP}[robots]'") | {"pybullet_data": _WITH_PYBULLET}


def cache_folder() -> Path:
    """Folder of new borders: the first writable one of `dbb_cache/` in a checkout and the
    `cache_folders`; if none is writable, the first of `cache_folders`.
    """
    if IN_CHECKOUT and is_writable(SHIPPED_CACHE):
        return SHIPPED_CACHE
    found = next(filter(is_writable, cache_folders()), None)
    return found or next(cache_folders(), SHIPPED_CACHE)


def user_robots() -> list[Path]:
    """Folders that have the user's robots as subfolders; the dashboard adds robots to the first.

    They are the entries of `$DBB_ROBOTS`. An empty entry, or an unset variable, means the folder
    `robots` in the user's data folder or, without a home, in `cache_folder`.
    """
    usual = (home_folder(platformdirs.user_data_path) or cache_folder()) / "robots"
    return [home_expanded(entry) if entry else usual for entry in _entries()]


def _entries() -> list[str]:
    """The entries of `$DBB_ROBOTS`; one empty entry if the variable is not set."""
    return [entry.strip() for entry in os.environ.get("DBB_ROBOTS", "").split(os.pathsep)]


def is_own(name: str) -> bool:
    """Whether a robot is the user's own; False for a delivered or unknown robot."""
    return robot_folder(name).parent != ASSETS


def robot_names() -> list[str]:
    """Names of the robots that have a description, including the user's."""
    tops = ASSETS, *user_robots()
    found = {path.name for top in tops for path in top.glob("*") if _has_robot(path)}
    return sorted(name for name in found if not name.startswith("."))  # unfinished robots


def check_robot_name(name: str) -> None:
    """Raise an UnknownNameError, which ends with `wrong_folders`, if a robot does not exist."""
    try:
        check_name("robot", name, robot_names())
    except UnknownNameError as error:
        if wrong := wrong_folders():
            error.args = (f"{error}; {wrong}",)
        raise


def wrong_folders() -> str:
    """A sentence about the first unusable folder of `$DBB_ROBOTS`; empty if there is none."""
    for folder in map(home_expanded, filter(None, _entries())):
        if isfile(folder / "robot.toml"):
            return f"DBB_ROBOTS names the folder of a robot, {folder}: name the folder around it"
        if not isdir(folder):
            what = "a file, not a folder" if isfile(folder) else "a folder that does not exist"
            return f"DBB_ROBOTS names {what}: {folder}"
        if not os.access(folder, os.R_OK | os.X_OK):
            return f"DBB_ROBOTS names a folder that this user cannot read: {folder}"
    return ""


def robot_folder(name: str) -> Path:
    """Folder of a robot; a delivered one has precedence. For an unknown name: in `ASSETS`."""
    return next(iter(_folders(name)), ASSETS / name)


def hidden_robot(name: str) -> str:
    """A sentence about a folder that another robot of this name hides; empty without one."""
    used, *others = dict.fromkeys(each.resolve() for each in _folders(name)) or [None]
    if not others:
        return ""
    winner = "a delivered robot" if used == (ASSETS / name).resolve() else f"the robot in {used}"
    return f"{others[0]} is not used, because {winner} has the same name; rename the folder"


def _folders(name: str) -> list[Path]:
    """All folders with a robot of this name; a delivered robot is first and has precedence."""
    tops = ASSETS, *user_robots()
    return [folder for top in tops if _has_robot(folder := top / name)]


def _has_robot(folder: Path) -> bool:
    """Whether a folder has a `robot.toml`, or may have one because this user cannot enter it."""
    hidden = isdir(folder) and not os.access(folder, os.X_OK)
    return hidden or os.path.exists(folder / "robot.toml")


def resolve_package_uri(uri: str) -> Path:
    """The file `package://PACKAGE/PATH` of an installed package, in one of its `package_roots`.

    Raises an AssetError if the address has a different form, the package or the file does not
    exist, or the path leads out of the package.
    """
    scheme, _, rest = uri.partition("://")
    package, _, inner = rest.partition("/")
    if scheme != "package" or not inner:
        raise AssetError(f"{uri!r} is not of the form package://PACKAGE/PATH")
    if not (roots := package_roots(package)):
        # No advice for other packages: the name comes from a file, and anyone can register it.
        how = f"; {_ADVICE[package]}" if package in _ADVICE else ""
        raise AssetError(f"{uri}: the package {package!r} is not installed{how}")
    for root in roots:
        path = followed(root / inner)
        if isfile(path) and path.is_relative_to(root.resolve()):
            return path
    raise AssetError(f"{uri}: no such file in the installed package {package!r}")


def followed(path: Path) -> Path:
    """A file's path without symbolic links. A link to a file with another ending stays, because
    readers select the format by the ending.
    """
    full = path.resolve()
    return full if full.suffix == path.suffix else path.parent.resolve() / path.name


def package_roots(package: str) -> list[Path]:
    """Folders of an installed package: those of the Python package, then those in `share_folders`.
    A package in the current directory does not count, unless `sys.path[1:]` has this directory.
    """
    spec = None
    if package.isidentifier() and package != "__main__":  # which has no folder
        spec = importlib.util.find_spec(package)
    roots = [Path(root) for root in (spec.submodule_search_locations if spec else None) or ()]
    with suppress(FileNotFoundError):  # the current directory has been removed
        here = Path.cwd()  # also the first folder of `sys.path`, for `python -m`
        if here not in map(Path, sys.path[1:]):  # otherwise installed, as in development
            roots = [root for root in roots if root.resolve().parent != here]
    if re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", package):
        roots += [share / package for share in share_folders() if isdir(share / package)]
    return roots


def share_folders() -> list[Path]:
    """The folders `share` of this Python; wheels install ROS packages in them."""
    libraries = {Path(sysconfig.get_path(kind)) for kind in ("purelib", "platlib")}
    prefixes = [*(library / "cmeel.prefix" for library in sorted(libraries)), Path(sys.prefix)]
    return [share for prefix in prefixes if (share := prefix / "share").is_dir()]


class HasUrdf(Protocol):
    """The part of a robot's description that states the place of the URDF."""

    name: str
    urdf: str  # path of the URDF in the folder of the robot `name`, or its `package://` address


def urdf_path(description: HasUrdf) -> Path:
    """The robot's URDF file; raises an AssetError if the file or its package is missing."""
    if description.urdf.startswith("package://"):
        return resolve_package_uri(description.urdf)
    path = robot_folder(description.name) / description.urdf
    if not isfile(path):
        raise AssetError(f"{description.name}: the URDF {path} does not exist")
    return path


PLANAR_JOINTS = ("planar_x", "planar_y", "planar_yaw")  # under the robot in `planar_urdf`
PLANAR_LINKS = ("planar_world", "planar_x_link", "planar_y_link")  # the parents of these joints
_ZERO_INERTIAL = (
    '<inertial><mass value="0"/>'
    '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'
)


def resolved_urdf(description: HasUrdf) -> str:
    """The robot's URDF (`read_urdf`) with the absolute path of each mesh. Also raises an AssetError
    for a missing mesh or a relative path out of the folder, a RobotFileError for a damaged mesh.
    """
    tree, folder = read_urdf(description), urdf_path(description).parent
    for mesh in tree.iter("mesh"):
        if reference := mesh.get("filename"):
            mesh.set("filename", str(_mesh(reference, folder)))
    return ElementTree.tostring(tree, encoding="unicode")


def shown_urdf(description: HasUrdf) -> str:
    """The URDF (`read_urdf`) with `file://` addresses of meshes, without unusable shapes."""
    tree, folder = read_urdf(description), urdf_path(description).parent
    for link, shape in shapes_of(tree):
        if (mesh := shape.find("geometry/mesh")) is not None:
            try:
                mesh.set("filename", _mesh(mesh.get("filename", ""), folder).resolve().as_uri())
            except (AssetError, RobotFileError):
                link.remove(shape)
    return ElementTree.tostring(tree, encoding="unicode")


def bare_urdf(description: HasUrdf) -> str:
    """The robot's URDF without shapes; its meshes may be missing. Errors: those of `read_urdf`."""
    tree = read_urdf(description)
    for link, shape in shapes_of(tree):
        link.remove(shape)
    return ElementTree.tostring(tree, encoding="unicode")


def shapes_of(tree: ElementTree.Element) -> list[tuple[ElementTree.Element, ElementTree.Element]]:
    """Pairs of elements of a URDF: a link, and one of its visual or collision shapes."""
    return [
        (link, shape)
        for link in tree.iterfind("link")
        for shape in (*link.findall("visual"), *link.findall("collision"))
    ]


def read_urdf(description: HasUrdf) -> ElementTree.Element:
    """The robot's URDF; a link without an inertia gets mass and inertia 0 (pybullet assumes 1 kg).

    Raises an AssetError if the file is missing, and a DescriptionError if it cannot be read,
    `xml_text` refuses it, or it has more than 200 moving joints.
    """
    path = urdf_path(description)
    try:
        tree = ElementTree.fromstring(xml_text(path))
    except (OSError, ValueError, RobotFileError) as error:
        why = str(error).removeprefix(f"{path}: ")
        raise DescriptionError(f"{path}: {why}") from None
    moving = sum(joint.get("type") != "fixed" for joint in tree.iterfind("joint"))
    if moving > _MAX_JOINTS:  # pinocchio's memory grows with the cube of their number
        raise DescriptionError(f"{path}: {moving} moving joints; the limit is {_MAX_JOINTS}")
    for link in tree.iterfind("link"):
        if link.find("inertial") is None:
            link.append(ElementTree.fromstring(_ZERO_INERTIAL))
    return tree


_UTF16 = {  # by a file's first bytes; without these, a file that declares UTF-16 is read as UTF-8
    **dict.fromkeys((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE), "utf-16"),
    **{b"<\0": "utf-16-le", b"\0<": "utf-16-be"},
}
_KINDS = {  # kinds of files by patterns of their beginning
    rb"#usda|PXR-USDC": "a USD file",
    b"%PDF": "a PDF",
    b"solid ": "an STL mesh (.stl)",
    rb"\x89PNG|\xff\xd8\xff|GIF8": "a picture",
    b"glTF": "a glTF mesh (.glb)",
    rb"\x7fELF": "a program",
    rb"(\s|<\?xml[^>]*>|" + COMMENT + rb")*<COLLADA": "a COLLADA mesh (.dae)",
    rb"([#\w][^\n]*\n|\s)*?v\s+[-.\d]+\s+[-.\d]": "an OBJ mesh (.obj)",
    b"ISO-10303-21": "a STEP file (.step)",
    b"Kaydara FBX": "an FBX file (.fbx)",
}
_DECLARED = re.compile(rb"""\s*<\?xml[^>]*?encoding\s*=\s*["']([\w.:-]+)["']""")


def refuse_hidden(path: Path) -> None:
    """Raise a PermissionError if this user may not see whether a file exists."""
    try:
        path.stat()
    except PermissionError:
        raise
    except (OSError, ValueError):
        pass


def refuse_placeholder(content: bytes, where: object) -> None:
    """Raise a RobotFileError if `content`, the start of the file `where`, is a `placeholder`."""
    if name := placeholder(content):
        raise RobotFileError(f"{where}: in the place of the file is {name}")


def kind_of(begin: bytes, size: int) -> str:
    """The kind of a file by its first bytes and its size [bytes]; empty if it is unknown."""
    if size == stated_stl(begin)[1]:
        return "an STL mesh (.stl)"
    begin = begin.removeprefix(codecs.BOM_UTF8)
    return next((name for key, name in _KINDS.items() if re.match(key, begin, re.DOTALL)), "")


def stated_stl(begin: bytes) -> tuple[int, int]:
    """Number of facets in a binary STL's header, and the size [bytes] of a file with them."""
    facets = int.from_bytes(begin[80:84], "little")
    return facets, 84 + 50 * facets


def xml_text(path: Path) -> str:
    """The text of a valid XML file: UTF-16 by its first bytes, or the declared encoding, or UTF-8.

    A RobotFileError means that the file is a placeholder or of another kind, is too large or cannot
    be decoded, or that `refuse_entities` refuses the text; an OSError, that it cannot be read.
    """
    try:
        content = content_of(path)
    except ValueError as error:
        raise RobotFileError(f"{path}: {error}") from None
    refuse_placeholder(content, path)
    if kind := kind_of(content[:_PART], len(content)):
        raise RobotFileError(f"{path}: it is {kind}, not a URDF")
    content = content.removeprefix(codecs.BOM_UTF8)
    declared = _DECLARED.match(content)
    stated = declared[1].decode().lower() if declared else "utf-8"
    code = _UTF16.get(content[:2], "utf-8" if stated.startswith("utf-16") else stated)
    try:
        text = content.decode(code)
    except (LookupError, ValueError) as error:
        how = "the encoding that it declares" if declared else "UTF-8, and it declares no other"
        raise RobotFileError(f"{path}: it is not in {how}: {error}; save it as UTF-8") from None
    text = text.strip("\ufeff\0 \t\r\n")  # other readers skip blanks before <?xml
    refuse_entities(text, path)
    return text


def refuse_entities(content: bytes | str, path: Path) -> None:
    """Raise a RobotFileError if the XML of a file `path` is not safe for a parser of trees.

    Unsafe XML declares an entity, as in a "billion laughs" attack, nests deeper or has more
    elements or attributes than any robot, or is not well-formed. `content` is bytes in their
    declared encoding, or text, whose declared encoding is ignored.
    """

    def refuse(name: str, *_: object) -> NoReturn:
        why = f"{path.name}: it declares the XML entity {name!r}, which could grow without end or"
        raise RobotFileError(f"{why} read other files; write its text instead, without <!ENTITY …>")

    depth = count = 0

    def begin(_: str, attributes: Sized) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > _DEEPEST or count > _MAX_ELEMENTS or len(attributes) > _MAX_ATTRIBUTES:
            more = f"more than {_MAX_ELEMENTS:,} elements, more than {_DEEPEST} nested levels, or "
            more += f"more than {_MAX_ATTRIBUTES} attributes of an element, which no robot has"
            raise RobotFileError(f"{path.name}: it has {more}")

    def end(*_: object) -> None:
        nonlocal depth
        depth -= 1

    encoding = "utf-8" if isinstance(content, str) else None
    parser = expat.ParserCreate(encoding, "}")  # with namespaces, as in ElementTree
    parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = begin, end
    try:
        parser.Parse(content, True)
    except (expat.ExpatError, LookupError, ValueError) as error:  # the last two: a wrong encoding
        declare = '; declare it in <robot>, such as xmlns:xacro="http://www.ros.org/wiki/xacro"'
        helps = declare if "unbound prefix" in str(error) else ""
        raise RobotFileError(f"{path}: not well-formed: {error}{helps}") from None


def _mesh(reference: str, folder: Path) -> Path:
    """The file of a mesh: in a package, at an absolute path, or within the URDF's folder."""
    if "://" in reference:
        return _intact(resolve_package_uri(reference))
    path, rule = Path(reference), ""
    if not path.is_absolute():
        path = (folder / reference).resolve()
        rule = "; a relative path must stay in the folder of the URDF"
    if not isfile(path) or (rule and not path.is_relative_to(folder.resolve())):
        raise AssetError(f"{folder.name}: no mesh {reference!r}{rule}")
    return _intact(path)


def _intact(path: Path) -> Path:
    """The path of a mesh; RobotFileError for a placeholder, or a damaged or unreadable file."""
    end, size = path.suffix.lower(), path.stat().st_size
    try:
        with path.open("rb") as file:
            begin, _ = file.read(_PART), file.seek(max(0, size - _PART))
            tail = b"\n" + file.read().lower()
    except OSError as error:
        raise RobotFileError(f"mesh {path}: {error.strerror}") from None
    refuse_placeholder(begin, f"mesh {path}")
    whole = re.search(_ENDS.get(end, b""), tail, re.DOTALL) is not None
    if end == ".stl" and b"\0" in begin:
        whole = 84 < stated_stl(begin)[1] <= size
    elif count := re.match(rb"# dbb: (\d+) faces", begin):  # of `in_pieces_urdf`
        whole = path.read_bytes().count(b"\nf ") >= int(count[1])
    if not whole:
        raise RobotFileError(f"mesh {path} is damaged ({size:,} bytes); copy or export it again")
    return path


def planar_urdf(description: HasUrdf) -> str:
    """The `resolved_urdf` on prismatic joints x and y and a revolute joint yaw, for pybullet."""
    text = resolved_urdf(description)
    parts = [f'<link name="{name}">{_ZERO_INERTIAL}</link>' for name in PLANAR_LINKS]
    ends = pairwise((*PLANAR_LINKS, root_link(text)))
    motions = ("prismatic", "1 0 0"), ("prismatic", "0 1 0"), ("revolute", "0 0 1")
    for name, (parent, child), (kind, axis) in zip(PLANAR_JOINTS, ends, motions, strict=True):
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="{axis}"/><limit lower="-1e6" upper="1e6" effort="1e6" velocity="1e3"/>'
            "</joint>"
        )
    return text.replace("</robot>", "".join(parts) + "</robot>")


def floats(text: str, count: int) -> list[float] | None:
    """The numbers in a text; None if the text is not `count` finite numbers."""
    words = text.split(None, count)  # an attribute may have millions
    if len(words) != count or not all(map(_NUMBER.fullmatch, words)):
        return None
    values = [float(word) for word in words]
    return values if all(map(math.isfinite, values)) else None


_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
"""A number that all readers of a URDF accept, unlike 1_000, which only Python accepts."""


def root_link(urdf: str) -> str:
    """Name of the root link of a URDF's text: the first link that is not the child of a joint."""
    tree = ElementTree.fromstring(urdf)
    children = {child.get("link") for child in tree.iterfind("joint/child")}
    names = (link.get("name") for link in tree.iterfind("link"))
    return next(str(name) for name in names if name not in children)
