"""All parameters of a run, as frozen records: numbers with a range, and choices among words.

The docstring of a parameter starts with its unit in brackets, and then states the meaning. The
command line, the dashboard's sliders and the checks of values are derived from these records.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from logging import getLogger
from typing import Any, Literal, NamedTuple

from pydantic import Field, ValidationError, model_validator

from app.errors import ConfigError, did_you_mean
from app.strict import Strict, explain


def number(
    default: float, low: float, high: float, label: str, *, advanced: bool = False, source: str = ""
) -> Any:
    """A field of a section: a number from `low` to `high`; the arguments are as in `Parameter`."""
    extra: dict[str, Any] = {"advanced": advanced, "source": source}
    return Field(default, ge=low, le=high, title=label, json_schema_extra=extra)


class Parameter(NamedTuple):
    """A tunable parameter: a number with a range, or a choice among words."""

    path: str  # section and name, such as `border.d_b`
    default: Any
    help: str
    label: str  # displayed name, followed by the symbol if there is one, without the unit
    unit: str  # `-` for a number without a unit, and for a choice
    low: float = math.nan  # NaN for a choice
    high: float = math.nan
    choices: tuple[str, ...] = ()  # the words; empty for a number
    advanced: bool = False  # whether the dashboard hides it until the user displays all parameters
    source: str = ""
    """Source of the default, or a reason for it; empty if the default is this project's choice."""

    @property
    def title(self) -> str:
        """Label with the unit, if there is one, such as `Buffer distance d_b [m]`."""
        return self.label if self.unit == "-" else f"{self.label} [{self.unit}]"

    @property
    def allowed(self) -> str:
        """The range or the choices, such as `0.05 to 0.3 m` or `surface or points`."""
        if self.choices:
            return " or ".join(self.choices)
        return f"{self.low:.15g} to {self.high:.15g} {self.unit}".removesuffix(" -")

    @property
    def log(self) -> bool:
        """Whether the slider is logarithmic: `low` is above 0, and `high` at least 1000 `low`."""
        return self.low > 0 and self.high / self.low >= 1000


class Section(NamedTuple):
    """Parameters that belong together."""

    name: str  # name in paths, such as `border`
    title: str
    about: str  # description in one sentence
    tunables: tuple[Parameter, ...]


def _read(path: str, field: dict[str, Any]) -> Parameter:
    """The parameter that a field's JSON schema describes."""
    unit, _, text = field["description"].removeprefix("[").partition("]")
    return Parameter(
        path=path,
        default=field["default"],
        help=" ".join(text.split()),
        label=field["title"],
        unit=unit,
        low=field.get("minimum", math.nan),
        high=field.get("maximum", math.nan),
        choices=tuple(field.get("enum", ())),
        advanced=field.get("advanced", False),
        source=field.get("source", ""),
    )


_TITLES = {  # titles of sections that differ from their names
    "ee_hold": "End-effector hold",
    "task": "Tasks",
    "limit": "Limits",
    "hand": "Person's hand",
    "disturbance": "Disturbances",
}
FORMER_NAMES = {  # names of parameters in older files, with the present names
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


class BorderConfig(Strict):
    """§2.2: the distance buffer border."""

    d_b: float = number(0.15, 0.05, 0.30, "Buffer distance d_b", source="paper, Figure 3, §3.4")
    """[m] buffer distance."""
    eps: float = number(0.01, 0.002, 0.02, "Border tolerance ε", source="paper, Figure 3")
    """[m] ε of (3): largest difference between d_b and a border point's distance to the base."""
    kind: Literal["surface", "points"] = Field(default="surface", title="Acting point on")
    """[-] surface: the acting point moves on the border's surface. points (hqp: always): it jumps
    between the paper's sampled points; at heights without such points, it moves on the surface."""


class ForceConfig(Strict):
    """§3.1: acting point and force."""

    f_max: float = number(
        300.0, 0.0, 600.0, "Force at contact f_max", source="traction limit of the paper's robot"
    )
    """[N] f_max of (14): force of a pair on the base at contact, for a horizontal normal."""
    f_arm: float = number(5.0, 0.0, 50.0, "Force on the arm f_arm")
    """[N] force at contact with which each pair of arm and base pushes a guided arm away. It moves
    a released arm out of the buffer. Only the controller dbb has it."""
    alpha_gain: float = number(
        0.001,
        0.0,
        0.1,
        "Step gain S_0",
        advanced=True,
        source="on the paper's robot α exceeds `alpha_min` up to 0.28 m from the wheel axis, at "
        "d = 0.1 m and R = 80",
    )
    """[m⁴/rad⁴] S_0 of (13), a gain of the step size α. With the distance d of a pair and the score
    S, α is 2 d on the wheel axis (S = 0) and about S_0 d / |S| far from this axis, but always
    between `alpha_min` and `alpha_max`. For a car-like base, S is divided by S_u (docs/bases.md).
    On a holonomic base S_0 has almost no effect: S is large there, and α is `alpha_min`."""
    alpha_min: float = number(0.02, 0.0, 0.10, "Smallest step α_min")
    """[m] lower bound of α of (13), the largest size of the step (12) from p_n to p_t."""
    alpha_max: float = number(0.15, 0.10, 0.40, "Largest step α_max")
    """[m] upper bound of α of (13), the largest size of the step (12) from p_n to p_t."""


class ActivationConfig(Strict):
    """§3.4: activation β of a pair, a cubic from 0 at d_b to 1 at d_full, over at least 20 mm."""

    d_full: float = number(0.05, 0.0, 0.05, "Full activation at d_full", source="paper, Figure 10")
    """[m] the avoidance task of a pair is fully active at distances up to d_full, or up to
    d_b − 0.02 m if that is smaller."""
    closest_point_smoothing: float = number(
        0.005, 0.001, 0.05, "Closest-point smoothing", advanced=True
    )
    """[m] smoothing length of the closest point. The closest point is a mean over the points of a
    link whose distances exceed the link's smallest distance by about this length or less."""


class RepulsionConfig(Strict):
    """§3.2: acceleration that separates two links of the arm; in `repulsive` also arm and base."""

    k_p: float = number(
        60.0,
        0.0,
        200.0,
        "Repulsion k_p",
        source="more than `hand.f_max` divided by a Panda's effective mass at the end-effector, "
        "about 0.9 kg or more",
    )
    """[m/s²] k_p of (20): constant part of the acceleration that separates the two links."""
    k_v: float = number(30.0, 0.0, 200.0, "Repulsion damping k_v")
    """[1/s] k_v of (20): factor of the damping by the relative speed of the two links."""


class BarrierConfig(Strict):
    """Barrier that keeps each pair at a minimum distance (controllers `dbb` and `barrier`)."""

    d_min: float = number(0.031, 0.005, 0.15, "Minimum distance d_min")
    """[m] minimum distance of each pair; torque limits have priority. Raise it only at rest."""
    rate: float = number(30.0, 10.0, 40.0, "Approach rate")
    """[1/s] approach rate: largest approach speed divided by the distance beyond d_min."""
    max_separation_speed: float = number(0.15, 0.05, 2.0, "Separation speed", advanced=True)
    """[m/s] upper bound of the separation speed that the barrier demands of a pair below d_min,
    also in penetration."""


class EeHoldConfig(Strict):
    """Reduction of avoidance motions of the base that drag the end-effector along."""

    min_speed: float = number(0.2, 0.01, 2.0, "Holding speed", advanced=True)
    """[m/s] v_h. The share 1/(1 + (s/v_h)⁴) of the base's motion in a direction counts as motion
    that the arm cannot compensate. s is the root of the sum of squares of the speeds at which the
    single joints can move the end-effector in this direction. For s = v_h the share is one half."""
    weight: float = number(3000.0, 0.01, 1e5, "End-effector hold weight")
    """[-] weight of the end-effector's motion that the base causes and the arm cannot compensate,
    as a multiple of the base's mass; it is also multiplied by β_m of (28)."""


class TaskConfig(Strict):
    """The tasks of end-effector and posture (only while tracking) and base; softness of T_sca."""

    ee_stiffness: float = number(900.0, 0.0, 4000.0, "End-effector stiffness")
    """[1/s²] position gain of the end-effector's task."""
    ee_damping: float = number(60.0, 0.0, 200.0, "End-effector damping")
    """[1/s] velocity gain of the end-effector's task."""
    ee_speed: float = number(0.5, 0.05, 2.0, "Correction speed limit")
    """[m/s] upper bound of the end-effector's correction speed; rad/s for its rotation."""
    posture_stiffness: float = number(4.0, 0.0, 100.0, "Posture stiffness")
    """[1/s²] stiffness of the arm's posture task. The task moves the arm towards its first measured
    posture or, after the fault `jump`, towards the posture at the newest `jump`."""
    joint_centering: float = number(8.0, 0.0, 100.0, "Joint-limit stiffness")
    """[1/s²] acceleration of a joint at a position limit towards the middle of its range, divided
    by half of the range. It is proportional to the fifth power of the distance from the middle."""
    posture_damping: float = number(4.0, 0.0, 100.0, "Posture damping")
    """[1/s] damping of the arm's posture task."""
    base_damping: float = number(3.0, 0.0, 20.0, "Base damping k")
    """[1/s] k of the acceleration −k q̇_b, which brings the base to rest."""
    base_time_scale: float = number(5.0, 1.0, 100.0, "Base time scale", advanced=True)
    """[-] ratio of the time constants of the base's tasks to those of the arm's. The base's tasks
    are slower, because its velocity command has a low rate."""
    base_weight: float = number(1000.0, 1.0, 1e6, "Base weight")
    """[-] cost of the base's acceleration q̈_b relative to a joint's acceleration. For a
    differential base, q̈_b is that of the wheels. The cost is a part of the posture task or, while
    a person guides the arm, of the task that brings the base to rest."""
    ee_weight: float = number(1e5, 1.0, 1e7, "End-effector weight", advanced=True)
    """[-] weight of the end-effector's task relative to the posture task."""
    slack_weight: float = number(1e-3, 1e-4, 0.1, "Softness ε", advanced=True)
    """[-] ε, softness of a fully active row of T_sca: ratio of the row's compliance to that of the
    tasks below T_sca. Joint limits and barriers have the softness ε². Limits of torques and of
    the base's acceleration are hard."""


class LimitConfig(Strict):
    """Rates at which the arm may approach its limits, and at which its torques may change."""

    position_rate: float = number(30.0, 1.0, 100.0, "Position-limit rate", advanced=True)
    """[1/s] approach rate of position limits: largest permitted joint speed divided by the distance
    from the limit."""
    velocity_rate: float = number(70.0, 1.0, 200.0, "Speed-limit rate", advanced=True)
    """[1/s] approach rate of speed limits: largest permitted joint acceleration divided by the
    difference of speed and limit."""
    torque_rate: float = number(1000.0, 600.0, 1e6, "Torque slew rate", source="limit of a Panda")
    """[N m/s] slew rate limit of the arm's torques; N/s for a prismatic joint. A Panda allows
    1000 N m/s."""


class EstimateConfig(Strict):
    """The filter of the arm's readings; it also estimates the external acceleration."""

    external_drift: float = number(3.0, 0.1, 100.0, "External push noise")
    """[rad/s²] smallest standard deviation of the change of the external joint acceleration in one
    second; m/s² for a prismatic joint. With noisy or rare readings, the value in use is larger."""
    least_noise: float = number(2e-8, 1e-9, 0.005, "Smallest position noise", advanced=True)
    """[rad] lower bound of the standard deviation of position noise; m for a prismatic joint."""
    velocity_noise: float = number(100.0, 1.0, 1e4, "Smallest velocity noise", advanced=True)
    """[1/s] lower bound of the ratio of two standard deviations: that of velocity noise to that of
    position noise."""
    noise_window: float = number(0.2, 0.01, 10.0, "Noise window", advanced=True)
    """[s] time window in which the noise of positions and velocities is estimated."""
    delay: float = number(0.0, 0.0, 0.03, "Known reading age", advanced=True)
    """[s] known age of the readings at a step's start; with time stamps, the part that they do not
    show. Above 24 control periods it counts as 24. Too large a value can make a guided arm too
    fast. A larger age is compensated up to 24 periods; with stamps, up to 0.1 s and 127 periods."""


class PayloadConfig(Strict):
    """Known load in the gripper, as a point mass; the collision model does not include the load."""

    mass: float = number(0.0, 0.0, 20.0, "Payload mass")
    """[kg] mass of the load. With an absent load the arm rises, with a large mass too fast."""
    x: float = number(0.0, -1.0, 1.0, "Payload centre x", advanced=True)
    """[m] x coordinate of the centre of mass in the end-effector's frame."""
    y: float = number(0.0, -1.0, 1.0, "Payload centre y", advanced=True)
    """[m] y coordinate of the centre of mass in the end-effector's frame."""
    z: float = number(0.0, -1.0, 1.0, "Payload centre z", advanced=True)
    """[m] z coordinate of the centre of mass in the end-effector's frame."""


class AdmittanceConfig(Strict):
    """§4.1: velocity command of the base, M_a v̇ + D_a v = F."""

    mass: float = number(60.0, 5.0, 300.0, "Virtual mass", source="m of the paper's robot")
    """[kg] M_a, virtual mass of the base's translation."""
    inertia: float = number(16.0, 0.5, 60.0, "Virtual inertia", source="I of the paper's robot")
    """[kg m²] M_a, virtual inertia of the base's rotation."""
    damping: float = number(180.0, 0.0, 600.0, "Linear damping")
    """[N s/m] D_a, damping of the base's translation."""
    angular_damping: float = number(160.0, 0.0, 600.0, "Angular damping")
    """[N m s] D_a, damping of the base's rotation."""
    v_max: float = number(0.5, 0.05, 2.0, "Top speed v_max")
    """[m/s] largest speed command along each linear axis; the base's own limit applies if it is
    lower."""
    omega_max: float = number(1.0, 0.1, 4.0, "Top turn rate ω_max")
    """[rad/s] largest commanded turn rate; the base's own limit applies if it is lower."""
    period: float = number(0.1, 0.001, 0.5, "Command period", source="paper, §4.1: 10 Hz")
    """[s] time between two velocity commands."""


class PersonConfig(Strict):
    """The hand of a person who holds a point of the arm: a spring and damper with a force limit."""

    stiffness: float = number(300.0, 10.0, 3000.0, "Pull stiffness")
    """[N/m] stiffness of the spring between the person's hand and the held point."""
    damping: float = number(25.0, 0.0, 200.0, "Pull damping")
    """[N s/m] damping of the held point's velocity in the world or, if the hand has a mass, of the
    velocity of this mass."""
    f_max: float = number(40.0, 1.0, 150.0, "Largest pull force")
    """[N] largest force of the spring and damper."""
    mass: float = number(0.0, 0.0, 5.0, "Mass of the hand", advanced=True)
    """[kg] mass of hand and forearm; the force that stops this mass can exceed `f_max`."""


class DisturbanceConfig(Strict):
    """Disturbances between controller and robot; none by default."""

    encoder_noise: float = number(0.0, 0.0, 0.005, "Encoder noise")
    """[rad] standard deviation of the noise of each joint's measured position; m for a prismatic
    joint. With noise, the measured joint velocities are computed from the noisy positions."""
    base_delay: float = number(0.0, 0.0, 0.5, "Base delay")
    """[s] additional delay from a velocity command to the base's drive."""
    mass_error: float = number(0.0, -0.3, 0.3, "Mass error")
    """[-] relative error of the arm's masses and inertias in the controller's model."""
    slip: float = number(0.0, 0.0, 0.5, "Slip")
    """[-] share of the base's commanded motion that is lost to slip."""
    sensor_delay: float = number(0.0, 0.0, 0.05, "Sensor delay")
    """[s] age of all readings on arrival."""
    sensor_period: float = number(0.0, 0.0, 0.05, "Sensor period")
    """[s] time between two new readings; the last reading is repeated in the meantime. 0 means a
    new reading in each step."""
    dropped: float = number(0.0, 0.0, 0.9, "Dropped readings")
    """[-] share of lost readings; the last reading is repeated instead."""
    unknown_load: float = number(0.0, 0.0, 10.0, "Unknown load")
    """[kg] mass of a load at the end-effector that the controller does not include."""
    stated_period: float = number(1e-3, 5e-4, 8e-3, "Stated period", source="paper, §4.1: 1 kHz")
    """[s] control period that the controller assumes at the start; the true period is 0.001 s."""
    time_stamps: Literal["no", "yes"] = Field(default="no", title="Time stamps")
    """[-] whether the controller gets a clock's time and the time stamps of the readings."""
    begins: float = number(0.0, 0.0, 60.0, "Begins")
    """[s] time at which `sensor_delay`, `sensor_period`, `dropped` and `unknown_load` begin."""


class Config(Strict):
    """All tunable parameters, in sections."""

    border: BorderConfig = BorderConfig()
    force: ForceConfig = ForceConfig()
    activation: ActivationConfig = ActivationConfig()
    repulsion: RepulsionConfig = RepulsionConfig()
    barrier: BarrierConfig = BarrierConfig()
    ee_hold: EeHoldConfig = EeHoldConfig()
    task: TaskConfig = TaskConfig()
    limit: LimitConfig = LimitConfig()
    estimate: EstimateConfig = EstimateConfig()
    payload: PayloadConfig = PayloadConfig()
    admittance: AdmittanceConfig = AdmittanceConfig()
    hand: PersonConfig = PersonConfig()
    disturbance: DisturbanceConfig = DisturbanceConfig()

    @model_validator(mode="before")
    @classmethod
    def _accept_former_names(cls, data: Any) -> Any:
        return _renamed(data) if isinstance(data, Mapping) else data

    def changed(self, values: Mapping[str, Any]) -> Config:
        """A copy with the `values` by path; raises a ConfigError if a path or value is invalid."""
        data = self.model_dump()
        for path, value in values.items():
            section, _, name = tunable(path).path.partition(".")
            data[section][name] = value
        return make_config(data)

    def replace(self, path: str, value: Any) -> Config:
        """A copy with one changed parameter; raises the errors of `changed`."""
        return self.changed({path: value})

    def changes(self, since: Config) -> dict[str, float | str]:
        """This record's values of all parameters that differ from `since`, by their paths."""
        return {path: v for path in tunables() if (v := self.value(path)) != since.value(path)}

    def value(self, path: str) -> float | str:
        """The value of a parameter; raises a ConfigError if the parameter does not exist."""
        section, _, name = tunable(path).path.partition(".")
        return getattr(getattr(self, section), name)


def slowed(config: Config) -> Config:
    """A copy for the base's QPs, with time constants longer by the factor `task.base_time_scale`:
    those of the end-effector's task, the repulsion, the barrier and the limits of joint positions.
    `limit.velocity_rate` gets the same new value as `limit.position_rate`.
    """
    task, repulsion, barrier = config.task, config.repulsion, config.barrier
    s = task.base_time_scale
    rate, speed = config.limit.position_rate / s, barrier.max_separation_speed / s
    slow = {
        "task": {"ee_stiffness": task.ee_stiffness / s**2, "ee_damping": task.ee_damping / s},
        "repulsion": {"k_p": repulsion.k_p / s**2, "k_v": repulsion.k_v / s},
        "limit": {"position_rate": rate, "velocity_rate": rate},
        "barrier": {"rate": barrier.rate / s, "max_separation_speed": speed},
    }
    changed = {name: getattr(config, name).model_copy(update=new) for name, new in slow.items()}
    return config.model_copy(update=changed)


def make_config(data: dict[str, Any], usual: Config | None = None) -> Config:
    """A configuration from `data[section][name]`; former names of parameters are valid.

    A missing parameter has the value of `usual` or, without `usual`, the default. If a parameter is
    unknown or invalid, this raises a ConfigError that names the parameter and the valid values.
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
    """A copy of `data[section][name]` with present names; ValueError if a parameter has two."""
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
    """The present name of a parameter; the first call with each former name logs a warning."""
    if path in FORMER_NAMES:
        getLogger(__name__).warning("parameter %s is now %s", path, FORMER_NAMES[path])
    return FORMER_NAMES.get(path, path)


@cache
def sections() -> tuple[Section, ...]:
    """All sections with their parameters, from the records above."""
    found = []
    for name, section in Config.model_fields.items():
        schema = type(section.default).model_json_schema()
        fields = schema["properties"].items()
        parameters = tuple(_read(f"{name}.{each}", field) for each, field in fields)
        title = _TITLES.get(name, name.capitalize())
        found.append(Section(name, title, schema.get("description", ""), parameters))
    return tuple(found)


@cache
def tunables() -> dict[str, Parameter]:
    """All parameters by their paths, in their order."""
    return {each.path: each for section in sections() for each in section.tunables}


def tunable(path: str) -> Parameter:
    """The parameter with a path, such as `border.d_b`; raises a ConfigError if there is none."""
    path = present_name(path)
    if path not in tunables():
        raise ConfigError(f"no parameter {path!r}{did_you_mean(path, tunables())}")
    return tunables()[path]


def parameter(path: str) -> Parameter:
    """The number with a path; raises a ConfigError if the path is unknown or that of a choice."""
    found = tunable(path)
    if found.choices:
        raise ConfigError(f"{path} is not a number but {found.allowed}")
    return found


def range_text(loc: tuple[int | str, ...], kind: str) -> str | None:
    """`valid_text` of `explain` for a `Config`: the valid values, or None at an unknown place."""
    if len(loc) == 1 and kind == "model_type":
        return "must be a section of parameters"
    if (known := tunables().get(".".join(map(str, loc)))) is None:
        return None
    return f"must be {'' if known.choices else 'within '}{known.allowed}"
