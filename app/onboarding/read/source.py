"""A URDF or xacro file as XML, and the files of its meshes."""

import os
import re
import unicodedata
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from itertools import chain
from os.path import isdir, isfile  # False also for a name that is too long for a file
from pathlib import Path
from urllib.parse import unquote
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from app.errors import RobotFileError, closest, extras_named
from app.jobs.bounded import within_budget
from app.robot.assets import (
    floats,
    followed,
    package_roots,
    refuse_entities,
    refuse_hidden,
    refuse_placeholder,
    resolve_package_uri,
    shapes_of,
    xml_text,
)
from app.strict import LARGEST_TEXT

MESHES = (".stl", ".dae", ".obj")  # endings of mesh files that pybullet reads
FORMATS = (*MESHES, ".glb", ".gltf", ".ply", ".off", ".3mf", "")
"""Endings of readable mesh files; a file without an ending is read as STL. `new-robot` converts
formats that pybullet does not read to STL."""
Packages = Callable[[str], Iterable[Path]]  # possible folders of a ROS package, best first
Folders = Mapping[str, Path]  # stated folders of ROS packages; these are not searched elsewhere
_IN_PACKAGE = ("package", "model")  # schemes of addresses in a package
_ABOVE = 2  # [-] number of folders above the URDF's folder to which a path can be relative


def locate(source: str) -> Path:
    """The file at a path, or at a `file://` or `package://` address. If there is no file, this
    raises a RobotFileError or, for `package://`, the AssetError of `resolve_package_uri`.
    """
    scheme, _, rest = _split_address(source)
    path = Path(os.path.expanduser(rest if scheme == "file" else source))
    path = resolve_package_uri(source) if scheme == "package" else path
    if not isfile(path):
        why = "it is a folder" if isdir(path) else f"no such file{_near(path.parent, path.name)}"
        raise RobotFileError(f"{source}: {why}; name a URDF, a xacro, a zip or package://PACKAGE/…")
    return followed(path)


def read_robot(
    path: Path, packages: Folders | None = None, arguments: Mapping[str, str] | None = None
) -> tuple[Element, list[str], Collection[str]]:
    """The `<robot>` of `read_source`, a sentence on each removed shape, and the arguments' names.
    Each mesh gets its `mesh_address`. Shapes of size 0 are removed; so are visual shapes for whose
    mesh `mesh_address` raises a RobotFileError, if their link also has a collision shape.
    """
    robot, known = read_source(path, packages, arguments)
    said = []
    for link, element in shapes_of(robot):
        name, why = link.get("name"), ""
        if (shape := element.find("geometry/*")) is None:
            continue
        sizes = [shape.get(key, "") for key in ("size", "radius", "length", "scale")]
        if not all(all(floats(size, n) or [1.0]) for size in sizes for n in (1, 3)):
            why = f"its {shape.tag} has the size 0"
        elif shape.tag == "mesh":
            try:
                if not (file := shape.get("filename")):
                    helps = "name its file, or remove the shape"
                    raise RobotFileError(f"link {name!r}: a mesh has no filename; {helps}")
                shape.set("filename", mesh_address(file, path.parent, packages))
            except RobotFileError as error:
                if element.tag == "collision" or link.find("collision") is None:
                    raise
                why = str(error)
        if why:
            link.remove(element)
            said.append(f"a {element.tag} of {name} is left out: {why}")
    return robot, said, known


def read_source(
    path: Path, packages: Folders | None = None, arguments: Mapping[str, str] | None = None
) -> tuple[Element, Collection[str]]:
    """The `<robot>` of a URDF or xacro, and the names of arguments that a xacro declares or uses.

    The content decides whether the file is a xacro. Attributes lose blanks at both ends, elements
    the namespace of `<robot>`. A RobotFileError is raised if the file is not well-formed XML, has
    entities or is no robot, if macros cannot be expanded, or if a xacro has `arguments` None.
    """
    text, known = xml_text(path), frozenset[str]()
    robot = _plain_xml(text)
    if left := _unexpanded(text, robot):
        if arguments is None:
            why = f"{left} is unexpanded xacro, which can contain Python and is not executed here"
            raise RobotFileError(f"{path.name}: {why}; expand it: xacro FILE -o robot.urdf")
        text, known = _expanded(path, text, packages or {}, arguments)
        refuse_entities(text, path)
        robot = _plain_xml(text)
        if left := _unexpanded(text, robot):
            raise RobotFileError(f"{path}: xacro does not expand {left}; correct it in the file")
    if robot.tag != "robot":
        raise RobotFileError(f"{path}: its root is <{robot.tag}>, a URDF's is <robot>")
    _refuse_unprefixed(path, robot, "include", "macro")
    return robot, known


def _plain_xml(text: str) -> Element:
    """The root of an XML text, without its namespace; the values of attributes are stripped."""
    robot = ElementTree.fromstring(text)
    own = robot.tag.removesuffix(robot.tag.rpartition("}")[2])
    for each in robot.iter():
        each.attrib = {key: value.strip() for key, value in each.items()}
        each.tag = each.tag.removeprefix(own)
    return robot


def _unexpanded(text: str, robot: Element) -> str:
    """The first xacro element or expression in a robot, or an empty string; `text` is its text."""
    code = re.sub("<!--.*?-->", "", text, flags=re.DOTALL)
    if found := re.search(r"<xacro:[^\s/>]+", code):  # any namespace is possible, as in xacro
        return f"{found[0]}>"
    if other := next((tag for e in robot.iter() if "/xacro}" in (tag := str(e.tag))), ""):
        return f"<{other.partition('}')[2]}> of xacro without the prefix xacro:"
    parts = (part for each in robot for part in each.iter() if each.tag in ("link", "joint"))
    values = (value for part in parts for value in part.attrib.values())
    return next((value for value in values if "${" in value or "$(" in value), "")


def _refuse_unprefixed(path: Path, robot: Element, *tags: str) -> None:
    """Refuse elements of xacro without their prefix: present versions of xacro ignore these."""
    for tag in (each.tag for each in robot if each.tag in tags):
        why = f"{path}: <{tag}> is xacro without its prefix; write <xacro:{tag}>"
        raise RobotFileError(f"{why}, and also <xacro:NAME> for each call of a macro")


def mesh_address(reference: str, folder: Path, packages: Folders | None = None) -> str:
    """The address of a mesh for the new URDF: `package://…` in an installed package, else its path.
    `reference` is the mesh's address in a URDF in `folder`. A RobotFileError is raised if no file
    exists in any of the `spellings`, if it has an unreadable format, or if it is a placeholder.
    """
    search = partial(_package_folders, folder=folder, named=packages or {})
    names = spellings(reference)
    if (found := next(filter(isfile, mesh_places(names, folder, search)), None)) is None:
        raise RobotFileError(f"mesh {reference}: {_missing(names[-1], folder, search)}")
    if found.suffix.lower() not in FORMATS:
        known = ", ".join(FORMATS[:-1])
        raise RobotFileError(f"mesh {reference}: {known} are read; convert it to one")
    if found.suffix.lower() != ".3mf":  # an archive, which counts as a placeholder
        with found.open("rb") as file:
            refuse_placeholder(file.read(1024), f"mesh {found}")
    full = found.resolve()
    for top in full.parents:
        if top in [root.resolve() for root in package_roots(top.name)]:
            return f"package://{full.relative_to(top.parent).as_posix()}"
    return str(followed(found))


def spellings(reference: str) -> list[str]:
    """Possible spellings of an address in the file system: unchanged, with URL escapes decoded,
    with slashes instead of backslashes, with both changes; and each in the forms NFD and NFC.
    """
    plain = reference.strip()
    slashed = plain.replace("\\", "/")
    meant = (plain, unquote(plain), slashed, unquote(slashed))
    normal = (unicodedata.normalize(form, each) for form in ("NFD", "NFC") for each in meant)
    return [*dict.fromkeys((*meant, *normal))]


def _split_address(reference: str) -> tuple[str, str, str]:
    """Scheme, package and path of an address; only schemes of `_IN_PACKAGE` have a package."""
    scheme, mark, rest = reference.partition(":")
    if not mark or len(scheme) == 1:  # a Windows drive letter
        return "", "", reference
    scheme, path = scheme.lower(), re.sub("//+", "/", rest.removeprefix("//"))
    if scheme in _IN_PACKAGE:
        package, _, path = path.lstrip("/").partition("/")
        return scheme, package, path
    return scheme, "", path.removeprefix("localhost") if scheme == "file" else path


def mesh_places(names: Iterable[str], folder: Path, packages: Packages) -> Iterator[Path]:
    """Possible files of a mesh by its `spellings`: in its package, or relative to the URDF's folder
    or the two folders above it; none for a scheme other than `package`, `model` or `file`.
    """
    for name in names:
        scheme, package, path = _split_address(name)
        own = (folder, *list(folder.parents)[:_ABOVE]) if scheme in ("file", "") else ()
        yield from (top / path for top in (packages(package) if scheme in _IN_PACKAGE else own))


def _missing(reference: str, folder: Path, packages: Packages) -> str:
    """Why the file of an address does not exist, with a correction."""
    scheme, package, path = _split_address(reference)
    if scheme in _IN_PACKAGE:
        if not (roots := [*dict.fromkeys(packages(package))]):
            return _nowhere(package, path, folder)
        where = f"no such file in the package {package!r}: {', '.join(map(str, roots))}"
        near = next(filter(None, (_near(root, path) for root in roots)), "")
        return f"{where}{near}; if this is the wrong folder, set --package {package}=FOLDER"
    if scheme not in ("file", ""):
        return "an address of the web or of another tool; name a file, relative to the URDF"
    if re.match("/?[A-Za-z]:", path):
        return "a path of another machine, of Windows; name the file relative to the URDF"
    return f"there is no file {folder / path}{_near(folder, path)}"


def _near(root: Path, path: str) -> str:
    """The text ` (did you mean 'x'?)` with the closest path below a folder, or an empty string."""
    refuse_hidden(root / path)
    found = Path()
    for part in Path(path).parts:
        names = [part] if part == ".." else [each.name for each in (root / found).glob("*")]
        if not (name := closest(part, names)):
            return ""
        found /= name
    return "" if found == Path(path) else f" (did you mean {found.as_posix()!r}?)"


def _nowhere(package: str, inner: str, folder: Path) -> str:
    """Where a missing package was searched, and the option that helps; `inner` is a file in it."""
    holders = [each for each in (folder, *folder.parents) if isfile(each / inner)]
    found = f"{holders[0]}, which contains a file of that path" if holders else "FOLDER"
    why = f"the package {package!r} is not a folder beside or above {folder}"
    why += ", is not in ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, and is not installed"
    return f"{why}; set --package {package}={found}"


def _package_folders(package: str, *, folder: Path, named: Folders) -> Iterator[Path]:
    """The possible folders of a package: only the one in `named` or, without one, those beside and
    above the URDF, then those in ROS's search paths, then those of installed packages.
    """
    if package in named:
        yield named[package]
        return
    for parent in (folder, *folder.parents):
        beside = (each.parent for each in parent.glob("*/package.xml"))
        for each in filter(isdir, chain((parent, parent / package), beside)):
            if package in (each.name, _stated_name(each)):
                yield each
    ros1 = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    ros2 = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    tops = [*map(Path, filter(None, ros1)), *(Path(each) / "share" for each in filter(None, ros2))]
    for top in filter(isdir, tops):
        found = (top / package, *top.glob(f"*/{package}"), top)
        yield from (each for each in found if each.name == package and isdir(each))
    yield from package_roots(package)


def _stated_name(folder: Path) -> str:
    """The name in a folder's `package.xml`, or "" without it; a download may rename the folder."""
    with suppress(OSError), (folder / "package.xml").open("rb") as file:
        text = re.sub(rb"<!--.*?-->", b"", file.read(1 << 16), flags=re.DOTALL)
        if found := re.search(rb"<name>\s*([\w.-]+)", text):
            return found[1].decode()
    return ""


def _expanded(
    path: Path, text: str, packages: Folders, arguments: Mapping[str, str]
) -> tuple[str, frozenset[str]]:
    """The result of `_urdf_of`; its errors become a `RobotFileError` with a remedy."""
    with extras_named():
        import xacrodoc  # noqa: F401 - it may be missing
    try:  # macros can produce unlimited text or never end
        return within_budget(_urdf_of, path, text, packages, arguments, size=LARGEST_TEXT)
    except Exception as error:  # xacro's errors have no common base class
        _refuse_unprefixed(path, _plain_xml(text), "include", "macro", "property")
        own, cause = str(next(iter(error.args), "")), getattr(error, "exc", None)
        file = str(cause.filename or "") if isinstance(cause, OSError) else ""
        # The text of some errors already contains that of their cause, with the name of its file.
        why = " ".join((own if own.endswith(f": {file or cause}") else str(error)).split())
        why += _near(path.parent, os.path.relpath(file, path.parent)) if file else ""
        if missing := re.search(r"Package not found: (\S+)", why):
            inner = re.search(rf"\$\(find {re.escape(missing[1])}\)/([^\"']+)", text)
            where = _nowhere(missing[1], inner[1] if inner else "", path.parent)
            raise RobotFileError(f"{path}: {where}") from None
        helps = "correct it, and try: xacro FILE"  # no option corrects a property or old syntax
        if lacking := re.search(r"substitution arg\w* (\S+)", why):
            helps = f"set it by --xacro {lacking[1]}=VALUE"
        raise RobotFileError(f"{path}: xacro cannot expand it: {why}; {helps}") from None


class _Arguments(dict[str, str]):
    """Arguments of a xacro; `known` has the names that the xacro declares or uses."""

    known = frozenset[str]()

    def __contains__(self, name: object) -> bool:  # which xacro calls for each <xacro:arg>
        self.known |= {str(name)}
        return super().__contains__(name)

    def __getitem__(self, name: str) -> str:
        self.known |= {name}
        return super().__getitem__(name)


def _urdf_of(
    path: Path, text: str, packages: Folders, arguments: Mapping[str, str]
) -> tuple[str, frozenset[str]]:
    """The URDF of a xacro with this text, and the names of arguments that it declares or uses."""
    import xacro
    from xacro import substitution_args
    from xacrodoc.packages import get_path

    folders = partial(_package_folders, folder=path.parent, named=packages)
    xacro.init_stacks(str(path))  # relative files of the xacro are in its folder
    xacro.substitution_args_context["filename"] = str(path)
    # $(dirname) is the folder of the present file, as in ROS.
    substitution_args._eval_dirname = lambda _: str(Path(xacro.filestack[-1]).absolute().parent)
    substitution_args._eval_find = lambda name: str(next(folders(name), None) or get_path(name))
    document, known = xacro.parse(text), _Arguments(arguments)
    xacro.process_doc(document, mappings=known)
    return document.toxml(), known.known
