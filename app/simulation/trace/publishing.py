"""From a control step to the snapshot that the dashboard sees."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from app.avoidance.self_collision import PairState
from app.control.explanation import explain
from app.robot.state import RobotState
from app.simulation.loop.pacing import Clock
from app.simulation.people import PullReading
from app.simulation.session import Session, Step
from app.simulation.trace.comparison import Ghost, GhostReading
from app.simulation.trace.snapshot import ActingReading, DoorView, PairReading, Snapshot

Array = np.ndarray


def make_snapshot(session: Session, step: Step, pacer: Clock, *, paused: bool) -> Snapshot:
    """The whole simulation at a control step; shares no memory with it, and is read-only."""
    state = session.state
    output, avoidance = step.output, step.output.avoidance
    acting = () if output.inserted.rows_m is None else avoidance.mobile
    quaternion = pin.Quaternion(state.T_world_ee.rotation).coeffs()  # x, y, z, w
    return Snapshot(
        t=step.t,
        base_pose=_frozen(step.truth.base_pose),
        base_velocity=_frozen(step.truth.base_velocity),
        base_velocity_command=_frozen(step.base_command),
        base_acceleration=_frozen(output.base_acceleration),
        avoidance_acceleration=_frozen(output.inserted.base_acceleration),
        wheel_angles=_frozen(session.wheel_angles),
        q_m=_frozen(step.truth.q_m),
        u_a=_frozen(output.u_a),
        p_ee=_frozen(state.T_world_ee.translation),
        wxyz_ee=_frozen(np.roll(quaternion, 1)),
        pairs=tuple(
            _pair_reading(session, pair, d)
            for pair, d in zip(avoidance.pairs, step.distances, strict=True)
        ),
        acting=tuple(_acting_reading(state, pair) for pair in acting if pair.acting is not None),
        beta_m=avoidance.beta_m,
        hand_target=None if step.hand_target is None else _frozen(step.hand_target),
        hand_force=_frozen(step.hand_force),
        ee_error=step.ee_error,
        in_contact=step.contacts.arm_base,
        arm_in_contact=step.contacts.arm_arm,
        solver_failures=session.controller.failures,
        step_time_us=pacer.step_time_us,
        realtime_factor=pacer.realtime_factor,
        overruns=pacer.overruns,
        paused=paused,
        mode="tracking" if output.tracking else "guiding",
        controller=session.controller.name,
        config=session.config,
        buffer=step.buffer,
        pulls=tuple(
            PullReading(who, link, *map(_frozen, vectors)) for who, link, *vectors in step.pulls
        ),
        door=_door_view(session, step),
        explanation=explain(session.controller, output, session.config, step.base_command),
    )


def ghost_reading(ghost: Ghost) -> GhostReading:
    """A ghost after its last control step; shares no memory with it, and is read-only."""
    reading = ghost.reading()
    return reading._replace(
        base_pose=_frozen(reading.base_pose),
        q_m=_frozen(reading.q_m),
        wheel_angles=_frozen(reading.wheel_angles),
        p_ee=_frozen(reading.p_ee),
    )


def _door_view(session: Session, step: Step) -> DoorView | None:
    if session.door is None:
        return None
    assert session.physics.door is not None, "a plant with a door"
    force = np.zeros(3) if step.door is None else step.door.force
    angle = session.physics.door.angle() if step.door is None else step.door.angle
    return DoorView(session.door.door, angle, _frozen(force))


def _pair_reading(session: Session, pair: PairState, d: float) -> PairReading:
    closest = pair.closest
    return PairReading(
        name=closest.pair.name,
        mobile=closest.pair.a == session.model.body_names[0],
        d=d,
        beta=pair.beta,
        p_a=_frozen(closest.p_a),
        p_b=_frozen(closest.p_b),
    )


def _acting_reading(state: RobotState, pair: PairState) -> ActingReading:
    acting = pair.acting
    assert acting is not None
    return ActingReading(
        name=pair.closest.pair.name,
        p_n=_frozen(state.to_world(acting.p_n)),
        p_t=_frozen(state.to_world(acting.p_t)),
        p_act=_frozen(state.to_world(acting.p_act)),
        f=_frozen(state.R_world_base @ pair.f),
    )


def _frozen(array: Array) -> Array:
    """A copy that refuses to be changed."""
    copy = np.array(array)
    copy.flags.writeable = False
    return copy
