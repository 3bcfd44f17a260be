"""A viewer pulls the end-effector by a gizmo or keys, or an arm's link by a drag."""

from collections.abc import Callable, Sequence
from threading import RLock
from time import monotonic

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.notifications import Notifier
from app.dashboard.record import Timeline
from app.dashboard.scene.scene import RobotScene
from app.simulation.loop.commands import Point, Pull, Release
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot
from app.strict import Array

GIZMO = "/gizmo"  # scene node of the gizmo
NUDGE = 0.02  # [m] displacement by one key press; a held key repeats it
MOST_NUDGED = 0.15  # [m] largest distance between the end-effector and its target by keys
SCALE = 0.26  # [m] length of the gizmo's arrows


class Grip:
    """Sends the pulls of one viewer, who holds at most one point of the robot; thread-safe."""

    def __init__(
        self, sink: LoopHandle, notifier: Notifier, client: viser.ClientHandle, timeline: Timeline
    ) -> None:
        self._sink, self.notifier, self._client, self._timeline = sink, notifier, client, timeline
        self._held: tuple[str | None, Point | None] | None = None  # if held: arguments of `take`
        self._pulls = False  # whether the simulation has a pull of this viewer
        self._warned = False
        self._moved = 0.0  # [s] time of the last `take` or `pull`
        self._target, self._by_keys = np.zeros(3), False  # [m] target by keys; whether keys hold
        self.reach: Callable[[Array], None] | None = None
        """If set, no pull is sent: this function gets each target (3,) [m] of the end-effector."""
        self._lock = RLock()

    @property
    def holds_end_effector(self) -> bool:
        held = self._held
        return held is not None and held[0] is None

    @property
    def holds_anything(self) -> bool:
        return self._held is not None

    def take(self, link: str | None = None, point: Point | None = None) -> None:
        """Release the held point, and hold another one; without a `link`, the end-effector.

        `point` (3,) [m] is in the frame of the joint `link`. If the page shows the past, it returns
        to the present with a message, and no point is held.
        """
        with self._lock:
            self.release()
            if not self._timeline.live:
                self._timeline.go_live()
                self.notifier.tell(self._client, "Now", "The page showed the past. Pull again.")
                return
            self._held, self._warned, self._moved = (link, point), False, monotonic()
            self._by_keys = False

    def pull(self, target: Array, *, by_keys: bool = False) -> None:
        """Pull the held point to a target (3,) [m] in the world.

        A call with `by_keys` has no effect unless keys hold the point; another call has no effect
        unless a drag does. A target below the floor is moved to z = 0, with one warning per held
        point. If `reach` is set, no pull is sent: `reach` gets the end-effector's unchanged target.
        """
        x, y, z = (float(value) for value in target)
        with self._lock:
            if self._held is None or self._by_keys != by_keys:
                return
            self._moved = monotonic()
            if self.reach is not None:
                if self.holds_end_effector:
                    self.reach(np.array(target))
                return
            if z < 0.0 and not self._warned:
                self._warned = True
                self.notifier.warn(self._client, "The floor is at z = 0; the target stays on it.")
            self._sink.send(Pull((x, y, max(z, 0.0)), *self._held, who=self._client.client_id))
            self._pulls = True

    def nudge(self, ahead: Sequence[float], snapshot: Snapshot) -> None:
        """Pull the end-effector by keys: shift the target by `NUDGE` times `ahead` (3,).

        `ahead` is forward, left and up in the base's frame, clipped to [−1, 1]. The target begins
        at the end-effector in `snapshot`, and stays within `MOST_NUDGED` of it. The first call of a
        pull makes the page show the present. During a drag, a call has no effect.
        """
        with self._lock:
            if self.holds_anything and not self._by_keys:
                return  # a drag determines the target
            if not self.holds_end_effector:
                self._timeline.go_live()  # the target is near the present end-effector
                self.take()
                self._target, self._by_keys = np.array(snapshot.p_ee), True
            step = pin.utils.rotate("z", float(snapshot.base_pose[2])) @ np.clip(ahead, -1.0, 1.0)
            reach = self._target + NUDGE * step - snapshot.p_ee
            reach *= MOST_NUDGED / max(float(np.linalg.norm(reach)), MOST_NUDGED)
            self._target = snapshot.p_ee + reach
            self.pull(self._target, by_keys=True)

    def release_keys(self) -> None:
        with self._lock:
            if self._by_keys:
                self.release()

    def release(self) -> None:
        """Release the held point; send a command only if a pull of this point was sent."""
        with self._lock:
            self._held = None
            if self._pulls:
                self._pulls = False
                self._sink.send(Release(self._client.client_id))

    def release_if_still(self, seconds: float) -> None:
        """Release the point, with a warning, if its last `take` or `pull` is over `seconds` ago."""
        with self._lock:
            if self._held is None or monotonic() - self._moved <= seconds:
                return
            self.release()
        text = "Your pull has ended, because your browser did not respond. Pull again."
        self.notifier.warn(self._client, text)


class DragHandles:
    """Handles for the mouse: the gizmo on the end-effector, and the meshes of the arm's links."""

    def __init__(
        self, scene: viser.SceneApi, robot: RobotScene, grip: Grip, arm_joints: dict[int, str]
    ) -> None:
        """Add the gizmo; `arm_joints` has the names of arm joints by index in the drawn model."""
        self.grip = grip
        self._gizmo = scene.add_transform_controls(
            GIZMO, scale=SCALE, disable_rotations=True, depth_test=False, opacity=0.7
        )
        self._gizmo.on_update(grip.notifier.guard(self._drag_gizmo))  # type: ignore[arg-type]
        self._robot, self._arm_joints = robot, arm_joints
        self._links: object = None
        self._dragged = False  # whether the viewer drags the gizmo

    def update(self, snapshot: Snapshot) -> None:
        """Move the gizmo to the end-effector unless dragged; make new meshes of links draggable."""
        if self._links is not self._robot.links:
            self._links = self._robot.links
            for joint, mesh in self._robot.links:
                if joint in self._arm_joints:
                    self._listen(mesh, joint, self._arm_joints[joint])
        if not self._dragged:
            self._gizmo.position = snapshot.p_ee

    def _drag_gizmo(self, event: viser.TransformControlsEvent) -> None:
        # A restart can release the pull earlier, but until "end" the browser ignores new positions.
        if event.phase == "end":
            self._dragged = False
            self.grip.release()
            return
        if event.phase == "start":  # an update can come after the end
            self._dragged = True
            self.grip.take()
        if self.grip.holds_end_effector:
            self.grip.pull(np.asarray(event.target.position))

    def _listen(self, mesh: viser.MeshHandle, joint: int, name: str) -> None:
        def dragged(event: viser.SceneNodeDragEvent) -> None:
            if event.phase == "end":
                self.grip.release()
                return
            if event.phase == "start":
                T: pin.SE3 = self._robot.world_pose(joint)
                x, y, z = map(float, T.actInv(np.array(event.start_position)))
                self.grip.take(name, (x, y, z))
            self.grip.pull(np.array(event.end_position))

        mesh.on_drag(self.grip.notifier.guard(dragged))  # type: ignore[arg-type]
