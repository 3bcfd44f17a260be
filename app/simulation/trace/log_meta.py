"""What a log says about the run as a whole, beside its rows."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, ValidationError

from app.config import Config
from app.errors import LogError
from app.robot.model import RobotModel
from app.simulation.trace.axis_columns import acceleration_column, velocity_column
from app.simulation.trace.snapshot import Snapshot
from app.strict import Strict, explain


class LogMeta(Strict):
    """The run that a log is about; its rows follow from it and from nothing else.

    Everything that stays the same, and what the names of the columns are made from.
    """

    format: Literal[1] = 1
    """[-] of the log; another one is refused."""
    robot: str
    """Name of the robot, as `dbb robots` lists it."""
    joints: tuple[str, ...]
    """The arm's joints, in the order of q_m."""
    joint_units: tuple[Literal["rad", "m"], ...]
    """Unit of the position of each of them."""
    velocities: tuple[str, ...] = ("v_mps", "w_radps")
    """Names of the base's velocities in the columns, in the order of its axes."""
    accelerations: tuple[str, ...] = ("a_mps2", "aw_radps2")
    """Names of their derivatives."""
    wheels: tuple[str, ...] = ("right", "left")
    """Names of the angles of the base's wheels."""
    pairs: tuple[str, ...]
    """All link pairs, in the order of the snapshots."""
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

    @classmethod
    def of(
        cls,
        model: RobotModel,
        first: Snapshot,
        *,
        scenario: str = "",
        physics: str = "",
        seed: int = 0,
    ) -> LogMeta:
        """The meta data of a run that begins with a snapshot.

        Args:
            model: The robot.
            first: The first snapshot of the log.
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
            velocities=tuple(map(velocity_column, base.axes)),
            accelerations=tuple(map(acceleration_column, base.axes)),
            wheels=tuple(wheels.name for wheels in base.wheels),
            pairs=tuple(pair.name for pair in first.pairs),
            mobile_pairs=tuple(pair.name for pair in first.pairs if pair.mobile),
            scenario=scenario,
            physics=physics,
            seed=seed,
            config=first.config,
        )


def header_text(meta: LogMeta, rows: int) -> str:
    """The meta data and the number of rows as one line of JSON."""
    return json.dumps({"dbb_log": meta.model_dump(mode="json"), "rows": rows}, allow_nan=False)


def read_header(text: str) -> tuple[LogMeta, int]:
    """What `header_text` wrote: the meta data and the number of rows.

    Raises:
        LogError: It is no header, or one of another format.
    """
    try:
        data = json.loads(text)
    except (ValueError, RecursionError):
        data = None
    if not isinstance(data, Mapping) or "dbb_log" not in data:
        raise LogError("it has no meta data of a log: dbb run --log writes logs")
    rows: Any = data.get("rows")
    if not isinstance(rows, int) or isinstance(rows, bool) or rows < 1:
        raise LogError(f"its meta data say rows: {rows!r}, not how many there are")
    try:
        meta = LogMeta.model_validate_json(json.dumps(data["dbb_log"]))
    except ValidationError as error:
        raise LogError(f"its meta data: {explain(error, LogMeta)}") from None
    if len(meta.joint_units) != len(meta.joints):
        raise LogError("its meta data: joint_units: not one for each of the joints")
    if not set(meta.mobile_pairs) <= set(meta.pairs):
        raise LogError("its meta data: mobile_pairs: not all of them are among the pairs")
    return meta, rows
