"""The description of a robot, `robot.toml`: its records, their validation, and its reader."""

from itertools import chain, combinations
from pathlib import Path
from typing import Annotated, Union, get_args

from pydantic import Field, SerializeAsAny, ValidationError, model_validator
from typing_extensions import Self

from app.config import Config, range_text
from app.errors import DescriptionError
from app.robot.assets import check_robot_name, robot_folder
from app.robot.bases.car_like import CarLikeBase
from app.robot.bases.differential import DifferentialBase
from app.robot.bases.holonomic import HolonomicBase
from app.robot.bases.kind import BaseKind
from app.robot.shapes import Shape
from app.strict import (
    Finite,
    NonNegative,
    Positive,
    Sourced,
    Strict,
    Vector3,
    explain,
    file_text,
    from_toml,
)

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]

KINDS: dict[str, type[BaseKind]] = {}  # kinds of base for descriptions, by their name in `kind`


class ArmDescription(Sourced):
    """The manipulator: its joints from the base outwards, its limits and its end-effector."""

    mount_link: str  # URDF link whose origin is the arm's mount: `p_base` of (9)
    joints: tuple[str, ...] = Field(min_length=1)  # of the URDF, from the base outwards
    end_effector_link: str  # URDF link that carries the end-effector
    end_effector_xyz_m: Vector3 = (0.0, 0.0, 0.0)
    """[m] origin of the end-effector's frame in the frame of `end_effector_link`."""
    end_effector_rpy_rad: Vector3 = (0.0, 0.0, 0.0)
    """[rad] fixed-axis roll, pitch and yaw of the end-effector's frame in the frame of
    `end_effector_link`; the z axis points out of the gripper."""
    # Limits of the joints, by default those of the URDF.
    position_lower: tuple[Finite, ...] | None = None  # [rad or m]
    position_upper: tuple[Finite, ...] | None = None  # [rad or m]
    max_velocity: tuple[Positive, ...] | None = None  # [rad/s or m/s]
    max_effort: tuple[Positive, ...] | None = None  # [N m or N]
    ready_position: tuple[Finite, ...]
    """[rad or m] joint positions of the ready posture, far from the limits and outside of all
    buffers."""
    joint_damping: tuple[NonNegative, ...]
    """[N m s/rad or N s/m] damping D of the joints while a person guides the arm."""

    @model_validator(mode="after")
    def _one_number_a_joint(self) -> Self:
        n = len(self.joints)
        if len(set(self.joints)) != n:
            raise ValueError("`joints` names a joint twice")
        limits = "position_lower", "position_upper", "max_velocity", "max_effort"
        for name in (*limits, "ready_position", "joint_damping"):
            value = getattr(self, name)
            if value is not None and len(value) != n:
                raise ValueError(f"{name}: needs {n} numbers, one for each joint; has {len(value)}")
        return self


class BodyDescription(Strict):
    """One link l_• of Figure 2b: a union of convex shapes that represents the links in `covers`."""

    source: str  # source of the shapes
    name: Name  # name, as in the pair `lm-lEE`
    frame: str  # URDF link in whose frame the shapes are
    shapes: tuple[Shape, ...] = Field(min_length=1)
    covers: tuple[str, ...] = Field(min_length=1)
    """URDF links that this body represents in distances and contacts. It encloses them, except for
    parts that can meet at most its neighbours."""
    nested: dict[str, tuple[str, ...]] = Field(default_factory=dict)
    """For links in `covers`, the links of other bodies that are nested with them. If nested links
    touch, this does not count as a contact."""


class ReachabilityDescription(Sourced):
    """The coefficients A, B and C of (9) for one body of the arm."""

    A_per_m2: Positive  # [1/m²]
    B_m: Positive  # [m]
    C: Positive  # [-]


class LinePlace(Sourced):
    """The line along which this robot's end-effector moves in a scenario."""

    start_m: Vector3
    """[m] start of the end-effector in the world; the base is at the origin and faces +x."""
    move_m: Vector3  # [m] displacement of the end-effector in the world


class RobotDescription(Strict):
    """All data of a robot that the method uses.

    `bodies` are in the order of the kinematic chain, with the mobile base l_m first. Neighbours in
    this order are connected by a joint, and are never a pair.
    """

    name: Name
    title: str  #: displayed title
    urdf: str
    """The robot's URDF: a file in the folder of the description, or an address in a package."""
    licence: str  #: licences of the assets that the URDF refers to
    base: SerializeAsAny[BaseKind]  #: the base, of one of `KINDS`
    arm: ArmDescription
    bodies: tuple[BodyDescription, ...] = Field(min_length=2)
    reachability: dict[str, ReachabilityDescription] = Field(default_factory=dict)
    """Reachability by the name of the body; each body that can meet l_m needs an entry."""
    lines: dict[str, LinePlace] = Field(default_factory=dict)
    """Lines by the name of the scenario. `guiding-lateral`, `guiding-front` and `tracking` need a
    line or a start from the user; `tracking` can use the line of `guiding-lateral`."""
    without_line: dict[str, str] = Field(default_factory=dict)
    """Reasons why a scenario has no line, by its name."""
    unwatched: dict[str, str] = Field(default_factory=dict)
    """Reasons why pairs of bodies are not monitored, by the pair's name, such as `lm-l2`.
    Neighbours are never monitored."""
    config: Config = Config()  #: parameters whose default differs for this robot, such as its d_b

    @model_validator(mode="after")
    def _names_agree(self) -> Self:
        names = [body.name for body in self.bodies]
        if len(set(names)) != len(names):
            raise ValueError("bodies: a name appears twice")
        if unknown := self.reachability.keys() - set(names[1:]):
            raise ValueError(
                f"reachability: no arm body is named {', '.join(sorted(unknown))}; "
                f"bodies of the arm: {', '.join(names[1:])}"
            )
        for body in self.bodies:
            foreign = {link for other in self.bodies if other != body for link in other.covers}
            others = set(chain(*body.nested.values())) - foreign
            if unknown := (body.nested.keys() - set(body.covers)) | others:
                raise ValueError(
                    f"bodies.{body.name}.nested: {', '.join(sorted(unknown))}: the keys must be "
                    "links that this body covers, the values links that other bodies cover"
                )
        pairs = [f"{a}-{b}" for a, b in combinations(names, 2)]
        if unknown := self.unwatched.keys() - set(pairs):
            raise ValueError(
                f"unwatched: there is no pair {', '.join(sorted(unknown))}; "
                f"pairs of bodies: {', '.join(pairs)}"
            )
        return self

    @property
    def nested(self) -> frozenset[frozenset[str]]:
        """Names of the links of each nested pair (`BodyDescription.nested`)."""
        return frozenset(
            frozenset((own, link))
            for body in self.bodies
            for own, links in body.nested.items()
            for link in links
        )

    @property
    def mobile_body(self) -> BodyDescription:
        """The body of the mobile base, l_m."""
        return self.bodies[0]

    def with_mobile_shapes(self, *shapes: Shape) -> Self:
        """A copy with further shapes on the base, such as cargo, in the frame of l_m."""
        first, *others = self.bodies
        loaded = first.model_copy(update={"shapes": (*first.shapes, *shapes)})
        return self.model_copy(update={"bodies": (loaded, *others)})

    def body(self, name: str) -> BodyDescription:
        """The body with this name, which must exist."""
        return next(body for body in self.bodies if body.name == name)


def register_base_kind(kind: type[BaseKind]) -> None:
    """Register a kind of base for descriptions: a class whose `kind` is a `Literal` of one name.

    Raises a DescriptionError if `kind` is not such a `Literal`, another kind has the name, or the
    class lacks a definition that `BaseKind` demands.
    """
    names = get_args(kind.model_fields["kind"].annotation)
    if len(names) != 1:
        raise DescriptionError(f"{kind.__name__}.kind must be a Literal of one name")
    missing = sorted({*kind.__abstractmethods__, *(() if hasattr(kind, "axes") else ("axes",))})
    if missing:
        raise DescriptionError(f"{kind.__name__} must define {', '.join(missing)}")
    if KINDS.setdefault(names[0], kind) is not kind:
        raise DescriptionError(f"another kind of base is named {names[0]!r}")
    field = RobotDescription.model_fields["base"]
    field.annotation = Union[tuple(KINDS.values())]  # type: ignore[assignment]  # noqa: UP007
    field.discriminator = "kind"
    RobotDescription.model_rebuild(force=True)


for _kind in (DifferentialBase, HolonomicBase, CarLikeBase):
    register_base_kind(_kind)


def differential(description: RobotDescription) -> DifferentialBase:
    """The base of a robot; raises a DescriptionError if it is not differential."""
    base = description.base
    if not isinstance(base, DifferentialBase):
        raise DescriptionError(f"{description.name} has a {base.kind} base, not a differential one")
    return base


def load_description(path: Path) -> RobotDescription:
    """Read and validate a description file.

    Raises a DescriptionError if the file is missing, unreadable or not TOML, or if a field is
    missing, unknown or invalid; the text names the file, the field and the valid values.
    """
    try:
        return RobotDescription.model_validate(from_toml(file_text(path)))
    except ValidationError as error:  # a kind of ValueError
        text = explain(error, RobotDescription, _wanted)
    except FileNotFoundError:
        text = "no such description"
    except OSError as error:
        text = f"cannot be read: {error.strerror}"
    except ValueError as error:
        text = f"not a TOML file: {error}"
    raise DescriptionError(f"{path}: {text}")


def _wanted(loc: tuple[int | str, ...], kind: str) -> str | None:
    return range_text(loc[1:], kind) if loc[:1] == ("config",) else None


def load_robot(name: str) -> RobotDescription:
    """The description of a robot by its folder's name, which replaces the `name` in the file.

    Errors: those of `check_robot_name` and `load_description`.
    """
    check_robot_name(name)
    return load_description(robot_folder(name) / "robot.toml").model_copy(update={"name": name})
