"""A loop without physics: the arm follows the pull kinematically, the base backs off."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from app.border.dbb import Cloud, make_cloud, quantise_distances, quantise_points
from app.border.mobile import MobileBody
from app.config import Config
from app.control.buffer_watch import BufferReading
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.loop.commands import (
    Choose,
    Command,
    Compare,
    Configure,
    Mailbox,
    Pause,
    Play,
    Pull,
    Release,
    Reset,
    Speed,
    StepOnce,
    Watch,
)
from app.simulation.people import PullReading, held_links, held_point
from app.simulation.trace.snapshot import (
    ActingReading,
    GhostReading,
    PairReading,
    Score,
    Snapshot,
)
from app.simulation.trace.trace import History, Stored

Array = np.ndarray

PAIRS = (("lm", "lEE"), ("lm", "l3"), ("l1", "lEE"), ("l1", "l3"), ("l2", "lEE"))
DT = 0.02  # [s] of one step of the loop
EE_SPEED = 0.25  # [m/s] speed of the end-effector towards the pull's target


class ScriptedLoop:
    """The interface of the simulation's loop; `commands` records all commands except `Watch`.

    The end-effector moves towards the mean target of its pulls; the base backs off at a speed in
    proportion to the activation. Distances, closest points and end-effector pose are those of the
    real model. Compared robots have the same arm, and bases that do not move. A scenario has only
    its name: it pulls nothing.
    """

    def __init__(self, model: RobotModel, q_m: Array | None = None) -> None:
        self.model = model
        self.commands: list[Command] = []
        self.error: BaseException | None = None
        self.silence = 0.0
        self.links = held_links(model)
        self._state = RobotState(model)
        self._distances = _PairDistances(model)
        self._q_start = np.array(model.description.arm.ready_position if q_m is None else q_m)
        self._config, self._paused, self._lock = Config(), False, threading.Lock()
        self._speed, self._controller, self._scenario = 1.0, "dbb", ""
        self._compared: Compare | None = None
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._history = History()
        self._begin()

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join()

    def send(self, command: Command) -> None:
        Mailbox().put(command, self.links)
        if isinstance(command, Watch):  # the fake also runs while no client watches
            return
        with self._lock:
            self._obey(command)
            self._publish()
            self.commands.append(command)  # last: a test that sees the command sees its effect

    def latest(self) -> Snapshot:
        return self._history.latest

    def history(self, after: float) -> list[Snapshot]:
        return [stored.snapshot for stored in self.stored(after)]

    def stored(self, after: float = -1.0) -> list[Stored]:
        with self._lock:
            return self._history.after(after)

    def pulls(self) -> list[tuple[float, float, float] | None]:
        """Targets of the pulls in `commands`; None for a release."""
        with self._lock:
            kinds = [c for c in self.commands if isinstance(c, (Pull, Release))]
            return [c.target if isinstance(c, Pull) else None for c in kinds]

    def pull_at_base(self, seconds: float) -> None:
        """Reset, pull the end-effector down in front of the base for `seconds`, then pause.

        After 1.5 s the end-effector is inside the border. At the end `commands` is cleared.
        """
        self.send(Pause(True))
        self.send(Reset())
        x, y, z = self.latest().p_ee
        self.send(Pull((x - 0.1, y, z - 0.55)))
        for _ in range(round(seconds / DT)):
            self.send(StepOnce(DT))
        self.commands.clear()

    def place(self, base_pose: Sequence[float] | None = None, q_m: Array | None = None) -> None:
        """Set the base's pose or the arm's posture; the next step starts from there."""
        with self._lock:
            if base_pose is not None:
                self._base[:] = base_pose
            if q_m is not None:
                self._q[:] = q_m
            self._t += DT
            self._publish()

    def _obey(self, command: Command) -> None:
        if isinstance(command, (Pull, Release)):
            self._pull(command)
        elif isinstance(command, Configure):
            self._config = command.config
        elif isinstance(command, Choose):
            self._controller = command.controller
        elif isinstance(command, Pause):
            self._paused = command.paused
        elif isinstance(command, Speed):
            self._speed = command.factor
        elif isinstance(command, StepOnce):
            self._paused = True
            self._step(command.seconds)
        elif isinstance(command, Compare):
            self._compared = command if command.controllers else None
            self._base_compared = self._base.copy()
        else:
            self._scenario = _scenario_name(command, self._scenario)
            self._begin()

    def _pull(self, command: Pull | Release) -> None:
        if isinstance(command, Release) or command.target is None:
            self._pulls.pop(command.who, None)
        else:
            self._scenario = ""
            self._pulls[command.who] = command

    def _begin(self) -> None:
        self._t, self._base = 0.0, np.zeros(3)
        self._q, self._v, self._wheel = self._q_start.copy(), 0.0, 0.0
        self._pulls: dict[int, Pull] = {}
        self._base_compared = np.zeros(3)
        self._publish()

    def _run(self) -> None:
        while not self._stopping.wait(DT / self._speed):
            with self._lock:
                if not self._paused:
                    self._step(DT)
                self._publish()

    def _step(self, dt: float) -> None:
        self._t += dt
        snapshot = self._history.latest
        self._v = -0.3 * snapshot.beta_m
        self._base[:2] += dt * self._v * np.array([np.cos(self._base[2]), np.sin(self._base[2])])
        self._wheel += dt * self._v / self.model.description.base.wheel_radius_m
        stretches = [pull.target - snapshot.p_ee for pull in snapshot.pulls if pull.link is None]
        if not stretches:
            return
        stretch = np.mean(stretches, axis=0)
        v = stretch * min(EE_SPEED / max(float(np.linalg.norm(stretch)), 1e-9), 1.0 / dt)
        J = self._state.J_ee[:3, 2:]
        self._q += dt * J.T @ np.linalg.solve(J @ J.T + 1e-3 * np.eye(3), v)
        self._q = np.clip(self._q, self.model.q_lower, self.model.q_upper)

    def _publish(self) -> None:
        state, config = self._state, self._config
        state.update(Measurement(self._base, np.zeros(2), self._q, np.zeros(self.model.n_m)))
        pairs = self._distances(state, config)
        p_ee = state.T_world_ee.translation.copy()
        pulls = tuple(self._pull_reading(pull, p_ee) for pull in self._pulls.values())
        of_ee = [pull for pull in pulls if pull.link is None]
        target = of_ee[0].target if of_ee else None
        error = 0.0 if target is None else float(np.linalg.norm(target - p_ee))
        beta_m = max(pair.beta for pair in pairs if pair.mobile)
        desired = beta_m * np.array([-0.8, 0.5])
        quaternion = pin.Quaternion(state.T_world_ee.rotation).coeffs()  # x, y, z, w
        clearance = min(pair.d for pair in pairs if pair.mobile)
        snapshot = Snapshot(
            t=self._t,
            base_pose=self._base.copy(),
            base_velocity=np.array([self._v, 0.0]),
            base_velocity_command=np.array([self._v, 0.0]),
            base_acceleration=desired,
            avoidance_acceleration=desired,
            wheel_angles=np.full(2, self._wheel),
            q_m=self._q.copy(),
            u_a=np.zeros(self.model.n_m),
            p_ee=p_ee,
            wxyz_ee=quaternion[[3, 0, 1, 2]],
            pairs=pairs,
            acting=tuple(_acting(p, config) for p in pairs if p.mobile and p.beta > 0),
            beta_m=beta_m,
            hand_target=target,
            hand_force=sum((pull.force for pull in of_ee), np.zeros(3)),
            ee_error=error,
            in_contact=any(p.d <= 0 for p in pairs),
            arm_in_contact=False,
            solver_failures=0,
            step_time_us=212.0,
            realtime_factor=self._speed,
            overruns=3,
            paused=self._paused,
            mode="guiding",
            controller=self._controller,
            config=config,
            d_b=config.border.d_b,
            speed=self._speed,
            pulls=pulls,
            buffer=BufferReading(0.0, 0.0, 0.0, 0.0, too_small=False, too_small_ever=False),
            scenario=self._scenario,
            scenario_ends=60.0 if self._scenario else None,
        )
        self._history.add(self._compare(snapshot, clearance))

    def _pull_reading(self, pull: Pull, p_ee: Array) -> PullReading:
        point = p_ee
        if pull.link is not None:
            joint, p = held_point(self.model, pull.link, pull.point or (0.0, 0.0, 0.0))
            point = self._state.data.oMi[joint].act(p)
        force = self._config.hand.stiffness * (np.array(pull.target) - point)
        force *= min(1.0, self._config.hand.f_max / max(float(np.linalg.norm(force)), 1e-9))
        return PullReading(pull.who, pull.link, point.copy(), np.array(pull.target), force)

    def _compare(self, snapshot: Snapshot, clearance: float) -> Snapshot:
        """Add the compared robots; besides clearance and error, their scores are zero."""
        if self._compared is None:
            return snapshot
        names = self._compared.controllers
        turn = pin.utils.rotate("z", (self._base_compared - self._base)[2])
        of_base = turn @ (snapshot.p_ee - [*self._base[:2], 0.0])
        p_ee = np.array([*self._base_compared[:2], 0.0]) + of_base
        return replace(
            snapshot,
            ghosts=tuple(
                GhostReading(
                    name,
                    self._base_compared.copy(),
                    snapshot.q_m,
                    snapshot.wheel_angles,
                    p_ee,
                    clearance,
                )
                for name in names
            ),
            scores=tuple(
                Score(name, clearance, snapshot.ee_error, 0.0, 0.0, 0.0, 0.0, 0.0, 0)
                for name in (snapshot.controller, *names)
            ),
            same=self._compared.same,
        )


def _scenario_name(command: Command, before: str) -> str:
    """Name of the scenario that runs after a command that starts anew."""
    if isinstance(command, Play):
        return command.scenario.name
    return "" if isinstance(command, Reset) else before


class _PairDistances:
    """Signed distances and closest points of the paper's pairs."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._geometry = model, model.geometry.copy()
        for a, b in PAIRS:
            ids = model.shape_ids[a][0], model.shape_ids[b][0]
            self._geometry.addCollisionPair(pin.CollisionPair(*ids))
        self._data = pin.GeometryData(self._geometry)

    def __call__(self, state: RobotState, config: Config) -> tuple[PairReading, ...]:
        pin.updateGeometryPlacements(self._model.pin, state.data, self._geometry, self._data)
        pin.computeDistances(self._geometry, self._data)
        readings = []
        d_b, d_full = config.border.d_b, config.activation.d_full
        for (a, b), result in zip(PAIRS, self._data.distanceResults, strict=True):
            d = float(result.min_distance)
            u = np.clip((d_b - d) / (d_b - d_full), 0.0, 1.0)
            p_a, p_b = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            readings.append(
                PairReading(f"{a}-{b}", a == "lm", d, float(u * u * (3 - 2 * u)), p_a, p_b)
            )
        return tuple(readings)


def _acting(pair: PairReading, config: Config) -> ActingReading:
    """The acting point for a flat border: p_n horizontally outward of p_b, p_t 0.1 m beside p_n."""
    out = (pair.p_b - pair.p_a) * [1.0, 1.0, 0.0]
    out /= max(float(np.linalg.norm(out)), 1e-9)
    p_n = pair.p_b + (config.border.d_b - pair.d) * out
    p_t = p_n + 0.1 * np.array([-out[1], out[0], 0.0])
    p_act = p_t - 0.015 * out
    f = pair.p_b - p_act
    f *= config.force.f_max * max(0.0, 1 - pair.d / config.border.d_b) / np.linalg.norm(f)
    return ActingReading(pair.name, p_n, p_t, p_act, f)


def fake_clouds(model: RobotModel, spacing: float = 0.012) -> dict[str, Cloud]:
    """P_i of the pairs with the base: a regular grid around l_m, as if all of it were reachable."""
    mobile = MobileBody(model)
    margin = 0.32  # [m] a little more than the largest buffer distance
    axes = [
        np.arange(low, high, spacing)
        for low, high in zip(mobile.lower - margin, mobile.upper + margin, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = quantise_points(grid[grid[:, 2] > 0.0])
    d_m = mobile.distance(grid * 1e-4)
    near = (d_m > 0.03) & (d_m < margin)
    return {
        f"{a}-{b}": make_cloud(f"{a}-{b}", grid[near], quantise_distances(d_m[near]))
        for a, b in PAIRS
        if a == "lm"
    }
