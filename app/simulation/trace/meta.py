"""What a trace says about its run as a whole, beside its rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, ValidationError

from app.config import Config
from app.errors import LogError
from app.robot.model import RobotModel
from app.simulation.trace.axis_columns import acceleration_column, velocity_column
from app.strict import Strict, explain


class TraceMeta(Strict):
    """The run that a trace is about: what stays the same, and what its columns are named from."""

    format: Literal[1, 2] = 2
    """[-] of the file; another one is refused. A file of 1 has 50 rows a second."""
    robot: str
    """Name of the robot, as `dbb robots` lists it."""
    joints: tuple[str, ...]
    """The arm's joints, in the order of q_m."""
    joint_units: tuple[Literal["rad", "m"], ...]
    """Unit of the position of each of them."""
    joint_speeds: tuple[float, ...] = ()
    """(n_m,) [rad/s or m/s] the largest that each of them may have; empty if it is not known."""
    velocities: tuple[str, ...] = ("v_mps", "w_radps")
    """Names of the base's velocities in the columns, in the order of its axes."""
    accelerations: tuple[str, ...] = ("a_mps2", "aw_radps2")
    """Names of their derivatives."""
    wheels: tuple[str, ...] = ("right", "left")
    """Names of the angles of the base's wheels."""
    pairs: tuple[str, ...]
    """All link pairs, in the order of the rows' distances."""
    mobile_pairs: tuple[str, ...]
    """Those of L_m among them."""
    scenario: str = ""
    """Empty if a person led the hand."""
    physics: str = ""
    """Kind of plant; empty if it is not known."""
    seed: int = Field(default=0, ge=0)
    """[-] of everything random in the run."""
    config: Config
    """Parameters at the first row; a row that has others says which."""

    stuck: dict[str, Any] | None = None
    """Where and why a tracked hand stopped short at the end (`Stuck`), if it did."""

    @classmethod
    def of(
        cls,
        model: RobotModel,
        pairs: Mapping[str, bool],
        config: Config,
        *,
        scenario: str = "",
        physics: str = "",
        seed: int = 0,
    ) -> TraceMeta:
        """The meta data of a run.

        Args:
            model: The robot.
            pairs: Names of all link pairs, and whether they are of L_m.
            config: Parameters at the first row.
            scenario: Name of the scenario, or nothing.
            physics: Kind of plant.
            seed: Of everything random in the run.
        """
        arm, base = model.description.arm, model.description.base
        kinds = (model.pin.joints[model.pin.getJointId(name)].shortname() for name in arm.joints)
        return cls(
            robot=model.description.name,
            joints=tuple(arm.joints),
            joint_units=tuple("m" if "JointModelP" in kind else "rad" for kind in kinds),
            joint_speeds=tuple(model.qd_max.tolist()),
            velocities=tuple(map(velocity_column, base.axes)),
            accelerations=tuple(map(acceleration_column, base.axes)),
            wheels=tuple(wheels.name for wheels in base.wheels),
            pairs=tuple(pairs),
            mobile_pairs=tuple(name for name, mobile in pairs.items() if mobile),
            scenario=scenario,
            physics=physics,
            seed=seed,
            config=config,
        )


def header_text(meta: TraceMeta, rows: int) -> str:
    """The meta data and the number of rows as one line of JSON."""
    return json.dumps({"dbb_log": meta.model_dump(mode="json"), "rows": rows}, allow_nan=False)


def read_header(text: str) -> tuple[TraceMeta, int]:
    """What `header_text` wrote: the meta data and the number of rows.

    Raises:
        LogError: It is no header, or one of another format.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, Mapping) or "dbb_log" not in data:
        raise LogError("it has no meta data of a log: dbb run --log or --out writes logs")
    rows: Any = data.get("rows")
    if not isinstance(rows, int) or isinstance(rows, bool) or rows < 1:
        raise LogError(f"its meta data say rows: {rows!r}, not how many there are")
    try:
        meta = TraceMeta.model_validate_json(json.dumps(data["dbb_log"]))
    except ValidationError as error:
        raise LogError(f"its meta data: {explain(error, TraceMeta)}") from None
    if len(meta.joint_units) != len(meta.joints):
        raise LogError("its meta data: joint_units: not one for each of the joints")
    if not set(meta.mobile_pairs) <= set(meta.pairs):
        raise LogError("its meta data: mobile_pairs: not all of them are among the pairs")
    return meta, rows
