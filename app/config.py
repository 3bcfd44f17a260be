"""All parameters of a run: frozen records, each field with its range, unit and meaning.

The command line, the dashboard's sliders and the checks are made from these records; a unit stands
in brackets at the start of a field's docstring.
"""

from __future__ import annotations

from typing import Any, Literal

from pydantic import Field, ValidationError

from app.errors import ConfigError
from app.strict import Strict, explain


class BorderConfig(Strict):
    """§2.2: the distance buffer border."""

    d_b: float = Field(default=0.15, ge=0.06, le=0.30)
    """[m] buffer distance."""
    eps: float = Field(default=0.01, ge=0.002, le=0.02)
    """[m] tolerance ε of (3)."""
    kind: Literal["surface", "points"] = "surface"
    """[-] the border as a continuous surface, or as the paper's points."""


class ForceConfig(Strict):
    """§3.1: acting point and force."""

    f_max: float = Field(default=300.0, ge=0.0, le=600.0)
    """[N] force at contact, f_max of (14)."""
    alpha_gain: float = Field(default=0.001, ge=0.0, le=0.1)
    """[-] factor of (13), in units of α |S| / d."""
    alpha_min: float = Field(default=0.02, ge=0.0, le=0.10)
    """[m] lower bound of the step α."""
    alpha_max: float = Field(default=0.15, ge=0.10, le=0.40)
    """[m] upper bound of the step α."""


class ActivationConfig(Strict):
    """§3.4: β rises from 0 at the buffer distance to 1 by the cubic of Figure 10."""

    d_full: float = Field(default=0.05, ge=0.0, le=0.05)
    """[m] distance at which the avoidance task is in full force."""
    d_above: float = Field(default=0.10, ge=0.02, le=0.30)
    """[m] distance from the base at which the arm itself begins to resist, from above."""
    d_last: float = Field(default=0.05, ge=0.01, le=0.30)
    """[m] the same from the side, where the base gives way first."""


class RepulsionConfig(Strict):
    """§3.2: acceleration that parts two links; also along the vertical part of an L_m normal."""

    k_p: float = Field(default=60.0, ge=0.0, le=200.0)
    """[m/s²] constant part of (20); about the person's force over the hand's effective mass."""
    k_v: float = Field(default=30.0, ge=0.0, le=200.0)
    """[1/s] damping of (20)."""


class BarrierConfig(Strict):
    """The compared method `barrier`: each distance a hard inequality of control-barrier type."""

    d_min: float = Field(default=0.05, ge=0.0, le=0.30)
    """[m] distance that is never undercut."""
    rate: float = Field(default=20.0, ge=1.0, le=100.0)
    """[1/s] how fast a pair may close in on that distance, per distance left."""


class TaskConfig(Strict):
    """The tasks below self-collision avoidance."""

    ee_stiffness: float = Field(default=900.0, ge=0.0, le=4000.0)
    """[1/s²] position gain of the end-effector's task."""
    ee_damping: float = Field(default=60.0, ge=0.0, le=200.0)
    """[1/s] velocity gain of the end-effector's task."""
    posture_stiffness: float = Field(default=4.0, ge=0.0, le=100.0)
    """[1/s²] pull of the arm towards its starting pose, lowest level."""
    posture_damping: float = Field(default=4.0, ge=0.0, le=100.0)
    """[1/s] damping of the arm, lowest level."""
    base_damping: float = Field(default=3.0, ge=0.0, le=20.0)
    """[1/s] k of the base's rest acceleration −k q̇_b."""
    base_slowness: float = Field(default=4.0, ge=1.0, le=100.0)
    """[-] how much slower the base corrects errors than the arm; its commands come at 10 Hz."""
    base_weight: float = Field(default=1000.0, ge=1.0, le=1e6)
    """[-] how much costlier the base's acceleration is than the arm's, lowest level."""
    soft_weight: float = Field(default=1e3, ge=1.0, le=1e6)
    """[-] of the end-effector's task against the posture, where a method has them on one level."""


class LimitConfig(Strict):
    """Limits of the arm as constraints of the QP."""

    position_rate: float = Field(default=30.0, ge=1.0, le=100.0)
    """[1/s] how fast a joint may close in on its position limit, per distance left."""
    velocity_rate: float = Field(default=30.0, ge=1.0, le=200.0)
    """[1/s] how fast a joint may close in on its velocity limit, per velocity left."""
    torque_rate: float = Field(default=1000.0, ge=50.0, le=1e6)
    """[N m/s] how fast a torque of the arm may change; a Panda takes 1000."""


class AdmittanceConfig(Strict):
    """§4.1: velocity command of the base, M_a v̇ + D_a v = F."""

    mass: float = Field(default=60.0, ge=5.0, le=300.0)
    """[kg] M_a, linear."""
    inertia: float = Field(default=16.0, ge=0.5, le=60.0)
    """[kg m²] M_a, angular."""
    damping: float = Field(default=180.0, ge=0.0, le=600.0)
    """[N s/m] D_a, linear."""
    angular_damping: float = Field(default=160.0, ge=0.0, le=600.0)
    """[N m s] D_a, angular."""
    v_max: float = Field(default=0.5, ge=0.05, le=2.0)
    """[m/s] largest commanded speed, within the base's own limit; one that the arm can follow."""
    omega_max: float = Field(default=1.0, ge=0.1, le=4.0)
    """[rad/s] largest commanded turn, within the base's own limit."""
    period: float = Field(default=0.1, ge=0.001, le=0.5)
    """[s] between two velocity commands."""


class HandConfig(Strict):
    """The hand of a person who guides the end-effector: a spring and damper with a force limit."""

    stiffness: float = Field(default=300.0, ge=10.0, le=2000.0)
    """[N/m]"""
    damping: float = Field(default=25.0, ge=0.0, le=200.0)
    """[N s/m]"""
    f_max: float = Field(default=40.0, ge=1.0, le=150.0)
    """[N] largest force."""


class DisturbanceConfig(Strict):
    """What stands between the controller and the robot; nothing by default."""

    encoder_noise: float = Field(default=0.0, ge=0.0, le=0.005)
    """[rad] standard deviation of the noise of each joint's measured position."""
    base_delay: float = Field(default=0.0, ge=0.0, le=0.5)
    """[s] from a velocity command to the base's drive, on top of the commands' own period."""
    mass_error: float = Field(default=0.0, ge=-0.3, le=0.3)
    """[-] by how much the arm's masses and inertias, as the controller has them, are too large."""
    slip: float = Field(default=0.0, ge=0.0, le=0.5)
    """[-] share of the base's commanded motion that is lost at the ground."""


def slowed(task: TaskConfig, repulsion: RepulsionConfig) -> tuple[TaskConfig, RepulsionConfig]:
    """The gains of the same closed loops, `base_slowness` times slower.

    Stretching time by a factor divides stiffnesses by its square and damping by itself.
    """
    s = task.base_slowness
    return (
        task.model_copy(
            update={"ee_stiffness": task.ee_stiffness / s**2, "ee_damping": task.ee_damping / s}
        ),
        repulsion.model_copy(update={"k_p": repulsion.k_p / s**2, "k_v": repulsion.k_v / s}),
    )


class Config(Strict):
    """Everything that can be tuned."""

    border: BorderConfig = BorderConfig()
    force: ForceConfig = ForceConfig()
    activation: ActivationConfig = ActivationConfig()
    repulsion: RepulsionConfig = RepulsionConfig()
    barrier: BarrierConfig = BarrierConfig()
    task: TaskConfig = TaskConfig()
    limit: LimitConfig = LimitConfig()
    admittance: AdmittanceConfig = AdmittanceConfig()
    hand: HandConfig = HandConfig()
    disturbance: DisturbanceConfig = DisturbanceConfig()

    def replace(self, path: str, value: Any) -> Config:
        """A copy with one parameter changed.

        Args:
            path: Section and name, as in `"border.d_b"`.
            value: The new value, in the parameter's unit.

        Raises:
            ConfigError: No such parameter, or a value out of its range.
        """
        section, _, name = path.partition(".")
        if (
            section not in type(self).model_fields
            or name not in type(getattr(self, section)).model_fields
        ):
            raise ConfigError(f"no parameter {path!r}")
        data = self.model_dump()
        data[section][name] = value
        return make_config(data)


def make_config(data: dict[str, Any]) -> Config:
    """A configuration from nested dictionaries, checked.

    Raises:
        ConfigError: Names each parameter that is unknown or out of its range, and the range.
    """
    try:
        return Config.model_validate(data)
    except ValidationError as error:
        raise ConfigError(explain(error, Config)) from None


class Parameter(Strict):
    """One parameter, as a slider or a help text needs it."""

    path: str
    """Section and name, as in `border.d_b`."""
    low: float
    high: float
    default: float
    unit: str
    help: str


def parameter(path: str) -> Parameter:
    """Range, default, unit and meaning of a parameter, read off the records above."""
    section, _, name = path.partition(".")
    field = type(getattr(Config(), section)).model_fields[name]
    bounds = {type(m).__name__: m for m in field.metadata}
    unit, _, text = (field.description or "[-]").removeprefix("[").partition("]")
    return Parameter(
        path=path, low=bounds["Ge"].ge, high=bounds["Le"].le,
        default=field.default, unit=unit, help=text.strip(),
    )  # fmt: skip
