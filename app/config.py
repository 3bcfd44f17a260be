"""All parameters of a run, as frozen records; a number has a range, a unit and a meaning.

The command line, the dashboard's sliders and the checks of values are derived from these records.
The unit is in brackets at the start of a field's docstring. A choice has words instead of a range.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from logging import getLogger
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from app.errors import ConfigError, did_you_mean
from app.parameters import Parameter, Section, Shown, Tunable, read_tunable
from app.strict import Strict, explain

FORMER_NAMES = {
    "activation.blend": "activation.closest_point_smoothing",
    "barrier.leaving": "barrier.max_separation_speed",
    "holding.speed": "ee_hold.min_speed",
    "holding.weight": "ee_hold.weight",
    "task.centring": "task.joint_centering",
    "task.base_slowness": "task.base_time_scale",
    "task.softness": "task.slack_weight",
    "estimate.push_change": "estimate.external_drift",
    "estimate.window": "estimate.noise_window",
}
"""Names of parameters in older files, with the present names."""


class BorderConfig(Strict):
    """§2.2: the distance buffer border."""

    d_b: Annotated[float, Shown("Buffer distance d_b")] = Field(default=0.15, ge=0.05, le=0.30)
    """[m] buffer distance."""
    eps: Annotated[float, Shown("Border tolerance ε")] = Field(default=0.01, ge=0.002, le=0.02)
    """[m] ε of (3): tolerance of the distance of border points from d_b."""
    kind: Annotated[Literal["surface", "points"], Shown("Acting point on")] = "surface"
    """[-] the acting point is on the border's continuous surface, or on the paper's sampled points
    and then jumps between these points."""


class ForceConfig(Strict):
    """§3.1: acting point and force."""

    f_max: Annotated[float, Shown("Force at contact f_max")] = Field(
        default=300.0, ge=0.0, le=600.0
    )
    """[N] f_max of (14): force of a pair on the base at contact, for a horizontal normal."""
    f_arm: Annotated[float, Shown("Force on the arm f_arm")] = Field(default=5.0, ge=0.0, le=50.0)
    """[N] reaction force on a guided arm at contact; it moves a released arm out of the buffer."""
    alpha_gain: Annotated[float, Shown("Step gain S_0", advanced=True)] = Field(
        default=0.001, ge=0.0, le=0.1
    )
    """[-] S_0 of (13), a gain of the step size α. With the distance d of a pair and the score S, α
    is 2 d on the wheel axis (S = 0) and about S_0 d / |S| far from this axis, but between
    `alpha_min` and `alpha_max`."""
    alpha_min: Annotated[float, Shown("Smallest step α_min")] = Field(default=0.02, ge=0.0, le=0.10)
    """[m] lower bound of α of (13), the size of the step from p_n along the border's tangent."""
    alpha_max: Annotated[float, Shown("Largest step α_max")] = Field(default=0.15, ge=0.10, le=0.40)
    """[m] upper bound of α of (13), the size of the step from p_n along the border's tangent."""


class ActivationConfig(Strict):
    """§3.4: activation β of a pair, a cubic from 0 at d_b to 1 at d_full, over at least 20 mm."""

    d_full: Annotated[float, Shown("Full activation at d_full")] = Field(
        default=0.05, ge=0.0, le=0.05
    )
    """[m] the avoidance task is fully active up to this distance, or d_b − 0.02 m if smaller."""
    closest_point_smoothing: Annotated[float, Shown("Closest-point blending", advanced=True)] = (
        Field(default=0.005, ge=0.001, le=0.05)
    )
    """[m] smoothing length of the closest point. The closest point is a mean over the parts of a
    link whose distances exceed the link's smallest distance by about this length or less."""


class RepulsionConfig(Strict):
    """§3.2: acceleration that separates two links of the arm."""

    k_p: Annotated[float, Shown("Repulsion k_p")] = Field(default=60.0, ge=0.0, le=200.0)
    """[m/s²] k_p of (20): constant part of the acceleration that separates the two links."""
    k_v: Annotated[float, Shown("Repulsion damping k_v")] = Field(default=30.0, ge=0.0, le=200.0)
    """[1/s] k_v of (20): factor of the damping by the relative speed of the two links."""


class BarrierConfig(Strict):
    """Barrier that keeps each pair at a minimum distance (controllers `dbb` and `barrier`)."""

    d_min: Annotated[float, Shown("Minimum distance d_min")] = Field(default=0.031, ge=0.0, le=0.30)
    """[m] minimum distance of each pair; torque limits are not exceeded to keep it."""
    rate: Annotated[float, Shown("Approach rate")] = Field(default=30.0, ge=1.0, le=100.0)
    """[1/s] approach rate: largest approach speed divided by the distance beyond d_min."""
    max_separation_speed: Annotated[float, Shown("Separation speed", advanced=True)] = Field(
        default=0.15, ge=0.05, le=2.0
    )
    """[m/s] upper bound of the separation speed that the barrier demands of a pair below d_min,
    also in penetration."""


class EeHoldConfig(Strict):
    """Reduction of base motion that the arm cannot compensate at the end-effector."""

    min_speed: Annotated[float, Shown("Holding speed", advanced=True)] = Field(
        default=0.2, ge=0.01, le=2.0
    )
    """[m/s] if joints at full speed move the end-effector slower than this in a direction, the arm
    counts as unable to compensate base motion in this direction."""
    weight: Annotated[float, Shown("End-effector hold weight")] = Field(
        default=3000.0, ge=0.01, le=1e5
    )
    """[-] weight of the end-effector motion that the base would cause, relative to the base's
    mass."""


class TaskConfig(Strict):
    """The tasks of end-effector, posture and base, and the softness of the avoidance rows."""

    ee_stiffness: Annotated[float, Shown("End-effector stiffness")] = Field(
        default=900.0, ge=0.0, le=4000.0
    )
    """[1/s²] position gain of the end-effector's task."""
    ee_damping: Annotated[float, Shown("End-effector damping")] = Field(
        default=60.0, ge=0.0, le=200.0
    )
    """[1/s] velocity gain of the end-effector's task."""
    ee_speed: Annotated[float, Shown("Correction speed limit")] = Field(
        default=0.5, ge=0.05, le=2.0
    )
    """[m/s] upper bound of the end-effector's correction speed; rad/s for its rotation."""
    posture_stiffness: float = Field(default=4.0, ge=0.0, le=100.0)
    """[1/s²] stiffness of the arm's posture task, towards the starting posture."""
    joint_centering: Annotated[float, Shown("Joint-limit stiffness")] = Field(
        default=8.0, ge=0.0, le=100.0
    )
    """[1/s²] stiffness towards the middle of a joint's range, for a joint at a position limit."""
    posture_damping: float = Field(default=4.0, ge=0.0, le=100.0)
    """[1/s] damping of the arm's posture task."""
    base_damping: Annotated[float, Shown("Base damping k")] = Field(default=3.0, ge=0.0, le=20.0)
    """[1/s] k of the acceleration −k q̇_b, which brings the base to rest."""
    base_time_scale: Annotated[float, Shown("Base time scale", advanced=True)] = Field(
        default=5.0, ge=1.0, le=100.0
    )
    """[-] ratio of the base's time constants to the arm's, because the base's velocity command has
    a low rate."""
    base_weight: float = Field(default=1000.0, ge=1.0, le=1e6)
    """[-] cost of the base's acceleration relative to the cost of the arm's acceleration, in the
    posture task."""
    ee_weight: Annotated[float, Shown("End-effector weight", advanced=True)] = Field(
        default=1e5, ge=1.0, le=1e7
    )
    """[-] weight of the end-effector's task relative to the posture task."""
    slack_weight: Annotated[float, Shown("Softness ε", advanced=True)] = Field(
        default=1e-3, ge=1e-4, le=0.1
    )
    """[-] ε, softness of a fully active row of T_sca. Joint limits and barriers have the softness
    ε²; torque limits are hard."""


class LimitConfig(Strict):
    """Limits of the arm as constraints of the QP."""

    position_rate: Annotated[float, Shown("Position-limit rate", advanced=True)] = Field(
        default=30.0, ge=1.0, le=100.0
    )
    """[1/s] approach rate of position limits: permitted joint speed divided by the remaining
    distance."""
    velocity_rate: Annotated[float, Shown("Speed-limit rate", advanced=True)] = Field(
        default=70.0, ge=1.0, le=200.0
    )
    """[1/s] approach rate of speed limits: permitted joint acceleration divided by the remaining
    speed."""
    torque_rate: Annotated[float, Shown("Torque slew rate")] = Field(
        default=1000.0, ge=50.0, le=1e6
    )
    """[N m/s] slew rate limit of the arm's torques; N/s for a prismatic joint. A Panda allows
    1000 N m/s."""


class EstimateConfig(Strict):
    """The filter of the arm's readings; it also estimates the external acceleration."""

    external_drift: Annotated[float, Shown("External push noise")] = Field(
        default=3.0, ge=0.1, le=100.0
    )
    """[rad/s²] smallest standard deviation of the change of the external joint acceleration in one
    second; m/s² for a prismatic joint. With noisy or rare readings a larger one is used."""
    least_noise: Annotated[float, Shown("Smallest position noise", advanced=True)] = Field(
        default=2e-8, ge=1e-9, le=0.005
    )
    """[rad] lower bound of the estimated standard deviation of position noise; m if prismatic."""
    velocity_noise: Annotated[float, Shown("Smallest velocity noise", advanced=True)] = Field(
        default=100.0, ge=1.0, le=1e4
    )
    """[1/s] lower bound of the standard deviation of velocity noise, divided by that of position
    noise."""
    noise_window: Annotated[float, Shown("Noise window", advanced=True)] = Field(
        default=0.2, ge=0.01, le=10.0
    )
    """[s] time window in which the noise of positions and velocities is estimated."""
    delay: Annotated[float, Shown("Known reading age", advanced=True)] = Field(
        default=0.0, ge=0.0, le=0.03
    )
    """[s] known age of the readings at the start of a control step; above 24 control periods, 24 of
    them count. The controller also detects and compensates a larger age, up to the same limit."""


class PayloadConfig(Strict):
    """Known load in the gripper: the controller includes the mass and centre, not the shape."""

    mass: Annotated[float, Shown("Payload mass")] = Field(default=0.0, ge=0.0, le=20.0)
    """[kg] mass of the load."""
    x: Annotated[float, Shown("Payload centre x", advanced=True)] = Field(
        default=0.0, ge=-1.0, le=1.0
    )
    """[m] x coordinate of the centre of mass in the end-effector's frame."""
    y: Annotated[float, Shown("Payload centre y", advanced=True)] = Field(
        default=0.0, ge=-1.0, le=1.0
    )
    """[m] y coordinate of the centre of mass in the end-effector's frame."""
    z: Annotated[float, Shown("Payload centre z", advanced=True)] = Field(
        default=0.0, ge=-1.0, le=1.0
    )
    """[m] z coordinate of the centre of mass in the end-effector's frame."""


class AdmittanceConfig(Strict):
    """§4.1: velocity command of the base, M_a v̇ + D_a v = F."""

    mass: Annotated[float, Shown("Virtual mass")] = Field(default=60.0, ge=5.0, le=300.0)
    """[kg] M_a, virtual mass of the base's translation."""
    inertia: Annotated[float, Shown("Virtual inertia")] = Field(default=16.0, ge=0.5, le=60.0)
    """[kg m²] M_a, virtual inertia of the base's rotation."""
    damping: Annotated[float, Shown("Linear damping")] = Field(default=180.0, ge=0.0, le=600.0)
    """[N s/m] D_a, damping of the base's translation."""
    angular_damping: float = Field(default=160.0, ge=0.0, le=600.0)
    """[N m s] D_a, damping of the base's rotation."""
    v_max: Annotated[float, Shown("Top speed v_max")] = Field(default=0.5, ge=0.05, le=2.0)
    """[m/s] largest speed command along each linear axis; if the base's own limit is lower, it
    applies."""
    omega_max: Annotated[float, Shown("Top turn rate ω_max")] = Field(default=1.0, ge=0.1, le=4.0)
    """[rad/s] largest commanded turn rate; if the base's own limit is lower, it applies."""
    period: Annotated[float, Shown("Command period")] = Field(default=0.1, ge=0.001, le=0.5)
    """[s] time between two velocity commands."""


class PersonConfig(Strict):
    """The hand of a person who holds a point of the arm: a spring and damper with a force limit."""

    stiffness: Annotated[float, Shown("Pull stiffness")] = Field(default=300.0, ge=10.0, le=3000.0)
    """[N/m] stiffness of the spring between the person's hand and the held point."""
    damping: Annotated[float, Shown("Pull damping")] = Field(default=25.0, ge=0.0, le=200.0)
    """[N s/m] damping against the world, of the held point or, if the hand has a mass, of this
    mass."""
    f_max: Annotated[float, Shown("Largest pull force")] = Field(default=40.0, ge=1.0, le=150.0)
    """[N] largest force of the spring and damper."""
    mass: Annotated[float, Shown("Mass of the hand", advanced=True)] = Field(
        default=0.0, ge=0.0, le=5.0
    )
    """[kg] mass of hand and forearm; the force that stops this mass can exceed `f_max`."""


class DisturbanceConfig(Strict):
    """Disturbances between controller and robot; none by default."""

    encoder_noise: float = Field(default=0.0, ge=0.0, le=0.005)
    """[rad] standard deviation of the noise of each joint's measured position; m for a prismatic
    joint."""
    base_delay: float = Field(default=0.0, ge=0.0, le=0.5)
    """[s] additional delay from a velocity command to the base's drive."""
    mass_error: float = Field(default=0.0, ge=-0.3, le=0.3)
    """[-] relative error of the arm's masses and inertias in the controller's model."""
    slip: float = Field(default=0.0, ge=0.0, le=0.5)
    """[-] share of the base's commanded motion that is lost to slip."""
    sensor_delay: float = Field(default=0.0, ge=0.0, le=0.05)
    """[s] age of all readings on arrival."""
    sensor_period: float = Field(default=0.0, ge=0.0, le=0.05)
    """[s] time between new readings; the last reading is repeated in the meantime. 0 means a new
    reading in each step."""
    dropped: Annotated[float, Shown("Dropped readings")] = Field(default=0.0, ge=0.0, le=0.9)
    """[-] share of lost readings; the last reading is repeated instead."""
    unknown_load: float = Field(default=0.0, ge=0.0, le=10.0)
    """[kg] mass of a load at the end-effector that the controller does not include."""
    stated_period: float = Field(default=0.001, ge=0.0005, le=0.008)
    """[s] control period that the controller assumes from the start of a run on; the true period
    is 0.001 s."""
    time_stamps: Literal["no", "yes"] = "no"
    """[-] whether the readings have time stamps, and each control step has the time of a clock."""
    begins: float = Field(default=0.0, ge=0.0, le=60.0)
    """[s] start of the late, repeated and lost readings, and of the unknown load."""


class Config(Strict):
    """All tunable parameters; the docstring of each field is the title of the section."""

    border: BorderConfig = BorderConfig()
    """Border"""
    force: ForceConfig = ForceConfig()
    """Force"""
    activation: ActivationConfig = ActivationConfig()
    """Activation"""
    repulsion: RepulsionConfig = RepulsionConfig()
    """Repulsion"""
    barrier: BarrierConfig = BarrierConfig()
    """Barrier"""
    ee_hold: EeHoldConfig = EeHoldConfig()
    """End-effector hold"""
    task: TaskConfig = TaskConfig()
    """Tasks"""
    limit: LimitConfig = LimitConfig()
    """Limits"""
    estimate: EstimateConfig = EstimateConfig()
    """Estimate"""
    payload: PayloadConfig = PayloadConfig()
    """Payload"""
    admittance: AdmittanceConfig = AdmittanceConfig()
    """Admittance"""
    hand: PersonConfig = PersonConfig()
    """Person's hand"""
    disturbance: DisturbanceConfig = DisturbanceConfig()
    """Disturbances"""

    @model_validator(mode="before")
    @classmethod
    def _accept_former_names(cls, data: Any) -> Any:
        return _renamed(data) if isinstance(data, Mapping) else data

    def changed(self, values: Mapping[str, Any]) -> Config:
        """A copy with some parameters changed.

        Args:
            values: The new values by the parameters' paths, such as `border.d_b`.

        Raises:
            ConfigError: A parameter does not exist, or a value is invalid.
        """
        data = self.model_dump()
        for path, value in values.items():
            section, _, name = tunable(path).path.partition(".")
            data[section][name] = value
        return make_config(data)

    def replace(self, path: str, value: Any) -> Config:
        """A copy with one parameter changed; raises the errors of `changed`."""
        return self.changed({path: value})

    def changes(self, since: Config) -> dict[str, float | str]:
        """This record's values of all parameters that differ from `since`, by their paths."""
        return {path: v for path in tunables() if (v := self.value(path)) != since.value(path)}

    def value(self, path: str) -> float | str:
        """The value of a parameter.

        Raises:
            ConfigError: The parameter does not exist.
        """
        section, _, name = tunable(path).path.partition(".")
        return getattr(getattr(self, section), name)


def slowed(config: Config) -> Config:
    """The configuration whose closed loops are slower by the factor `task.base_time_scale`.

    `ee_stiffness` and k_p are divided by the square of the factor; `ee_damping`, k_v,
    `barrier.rate` and `max_separation_speed` by the factor. Both rates of joint limits become
    `position_rate` divided by the factor. The gains of posture and base damping do not change.
    """
    task, repulsion, limit, barrier = config.task, config.repulsion, config.limit, config.barrier
    s = task.base_time_scale
    slow = {
        "task": {"ee_stiffness": task.ee_stiffness / s**2, "ee_damping": task.ee_damping / s},
        "repulsion": {"k_p": repulsion.k_p / s**2, "k_v": repulsion.k_v / s},
        "limit": {
            "position_rate": limit.position_rate / s,
            "velocity_rate": limit.position_rate / s,
        },
        "barrier": {
            "rate": barrier.rate / s,
            "max_separation_speed": barrier.max_separation_speed / s,
        },
    }
    return config.model_copy(
        update={
            name: getattr(config, name).model_copy(update=gains) for name, gains in slow.items()
        }
    )


def make_config(data: dict[str, Any], usual: Config | None = None) -> Config:
    """A checked configuration from nested dictionaries.

    Missing parameters come from `usual`, or are the defaults without `usual`.

    Raises:
        ConfigError: A parameter is unknown or invalid; the message names such parameters, and the
            valid values.
    """
    try:
        # Strict: `true` and "0.2" are not numbers.
        config = Config.model_validate(data, strict=True)
    except ValidationError as error:
        raise ConfigError(explain(error, Config, range_text)) from None
    if usual is None:
        return config
    parts = _renamed(data).items()
    given = {f"{name}.{each}": v for name, part in parts for each, v in part.items()}
    return usual.changed(given)


def _renamed(data: Mapping[str, Any]) -> dict[str, Any]:
    """Nested dictionaries of parameters with former names replaced by the present ones.

    Raises:
        ValueError: A parameter has a value under both names.
    """
    found = {name: dict(s) if isinstance(s, Mapping) else s for name, s in data.items()}
    for former, path in FORMER_NAMES.items():
        (old_section, old), (section, name) = former.split("."), path.split(".")
        values, target = found.get(old_section), found.get(section, {})
        if not (isinstance(values, dict) and isinstance(target, dict) and old in values):
            continue
        if name in target:
            raise ValueError(f"{former} is the former name of {path}: state only one of them")
        found[section] = target | {name: values.pop(old)}
        if not found[old_section]:
            del found[old_section]
        present_name(former)
    return found


@cache
def present_name(path: str) -> str:
    """The present name of a parameter; the first call with a former name logs one line."""
    if path in FORMER_NAMES:
        getLogger(__name__).warning("parameter %s is now %s", path, FORMER_NAMES[path])
    return FORMER_NAMES.get(path, path)


@cache
def sections() -> tuple[Section, ...]:
    """All sections with their parameters, from the records above."""
    return tuple(
        Section(
            name,
            section.description or name,
            (type(section.default).__doc__ or "").strip(),
            tuple(
                read_tunable(name, each, field)
                for each, field in type(section.default).model_fields.items()
            ),
        )
        for name, section in Config.model_fields.items()
    )


@cache
def tunables() -> dict[str, Tunable]:
    """All parameters by their paths, in their order."""
    return {each.path: each for section in sections() for each in section.tunables}


def tunable(path: str) -> Tunable:
    """The parameter with a path, such as `border.d_b`.

    Raises:
        ConfigError: The parameter does not exist.
    """
    path = present_name(path)
    if path not in tunables():
        raise ConfigError(f"no parameter {path!r}{did_you_mean(path, tunables())}")
    return tunables()[path]


def parameter(path: str) -> Parameter:
    """Range, default, unit and meaning of a parameter that is a number.

    Raises:
        ConfigError: The parameter does not exist, or is a choice among words.
    """
    found = tunable(path)
    if not isinstance(found, Parameter):
        raise ConfigError(f"{path} is not a number but {found.allowed}")
    return found


def range_text(loc: tuple[int | str, ...], kind: str) -> str | None:
    """The valid values at a place of a configuration, for `explain`; None for an unknown place."""
    if len(loc) == 1 and kind == "model_type":
        return "must be a section of parameters"
    known = tunables().get(".".join(map(str, loc)))
    if known is None:
        return None
    return f"must be {'within ' if isinstance(known, Parameter) else ''}{known.allowed}"
