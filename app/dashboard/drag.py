"""Pulls by a viewer: of the end-effector with a gizmo or keys, or of any link of the arm."""

from collections.abc import Callable, Sequence
from threading import RLock
from time import monotonic

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.notifications import Notifier
from app.dashboard.scene.scene import RobotScene
from app.dashboard.timeline import Timeline
from app.simulation.loop.commands import Point, Pull, Release
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot
from app.strict import Array

GIZMO = "/gizmo"  # scene node of the gizmo
NUDGE = 0.02  # [m] displacement by one key press
MOST_NUDGED = 0.15  # [m] largest distance between the end-effector and its target by keys
SCALE = 0.26  # [m] length of the gizmo's arrows


class Grip:
    """The pull of one viewer, who holds at most one point; forces of several viewers add up.

    All methods are thread-safe: after a release, no pull of an earlier event follows.
    """

    def __init__(
        self, sink: LoopHandle, notifier: Notifier, client: viser.ClientHandle, timeline: Timeline
    ) -> None:
        """Start without a pull; commands to `sink` have the number of `client`."""
        self._sink, self._notifier, self._client, self._timeline = sink, notifier, client, timeline
        self._held: tuple[str | None, Point | None] | None = None
        """Link and point as in `take`; None without a pull."""
        self._pulls = False  # whether the simulation has a pull of this viewer
        self._warned = False
        self._moved = 0.0  # [s] time of the last pull
        self._target, self._by_keys = np.zeros(3), False  # [m] target of a pull by keys
        self.reach: Callable[[Array], None] | None = None
        """If set, it gets targets (3,) [m] of the end-effector, and nothing is pulled."""
        self._lock = RLock()

    @property
    def holds_end_effector(self) -> bool:
        held = self._held
        return held is not None and held[0] is None

    @property
    def holds_anything(self) -> bool:
        return self._held is not None

    def take(self, link: str | None = None, point: Point | None = None) -> None:
        """Start to hold a point of the robot, by default the end-effector; release the last one.

        `link` is the joint that moves the held link; `point` (3,) [m] is in this joint's frame. If
        the page shows the past, it returns to the present, and nothing is held.
        """
        with self._lock:
            self.release()
            if not self._timeline.live:
                self._timeline.go_live()
                self._notifier.tell(self._client, "Now", "The page showed the past. Pull again.")
                return
            self._held, self._warned, self._moved = (link, point), False, monotonic()
            self._by_keys = False

    def pull(self, target: Array, *, by_keys: bool = False) -> None:
        """Pull the held point to a target (3,) [m] in the world; a negative z is replaced by 0.

        Without a held point, there is no effect. The same holds for the remaining events of a drag
        during a pull by keys. If `reach` is set, it gets the unchanged target instead.
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
                self._warned = True  # warn once per drag
                self._notifier.warn(self._client, "The floor is at z = 0; the target stays on it.")
            self._sink.send(Pull((x, y, max(z, 0.0)), *self._held, who=self._client.client_id))
            self._pulls = True

    def nudge(self, ahead: Sequence[float], snapshot: Snapshot) -> None:
        """Pull the end-effector by keys: shift its target by `NUDGE` times `ahead`; not in a drag.

        `ahead` (3,) is clipped to −1 to 1, along the axes forward, left and up of the base.
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
            scale = MOST_NUDGED / max(float(np.linalg.norm(reach)), MOST_NUDGED)
            self._target = snapshot.p_ee + scale * reach
            self.pull(self._target, by_keys=True)

    def release_keys(self) -> None:
        """Release a pull by keys; another pull continues."""
        with self._lock:
            if self._by_keys:
                self.release()

    def release(self) -> None:
        """Release the held point; the simulation gets a command only if it has a pull."""
        with self._lock:
            self._held = None
            if self._pulls:
                self._pulls = False
                self._sink.send(Release(self._client.client_id))

    def release_if_still(self, seconds: float) -> None:
        """Release the held point if its last pull is older than `seconds`, and warn the viewer."""
        with self._lock:
            if self._held is None or monotonic() - self._moved <= seconds:
                return
            self.release()
        text = "Your pull has ended, because your browser did not respond. Pull again."
        self._notifier.warn(self._client, text)


class DragHandles:
    """The gizmo on the end-effector, and the links of the arm, which can be dragged."""

    def __init__(
        self,
        scene: viser.SceneApi,
        robot: RobotScene,
        grip: Grip,
        notifier: Notifier,
        arm_joints: dict[int, str],
    ) -> None:
        """Add the gizmo to the scene, and handle drags of the gizmo and of the arm's links.

        `arm_joints` has the names of the arm's joints, by their index in the drawn model.
        """
        self.grip = grip
        self._gizmo = scene.add_transform_controls(
            GIZMO, scale=SCALE, disable_rotations=True, depth_test=False, opacity=0.7
        )
        self._gizmo.on_update(notifier.guard(self._drag_gizmo))  # type: ignore[arg-type]
        self._robot, self._arm_joints, self._notifier = robot, arm_joints, notifier
        self._links: object = None
        self._dragged = False  # whether the viewer drags the gizmo

    def update(self, snapshot: Snapshot) -> None:
        """Move the gizmo to the end-effector, but not while this viewer drags the gizmo."""
        if self._links is not self._robot.links:
            self._links = self._robot.links
            for joint, mesh in self._robot.links:
                if joint in self._arm_joints:
                    self._listen(mesh, joint, self._arm_joints[joint])
        if not self._dragged:
            self._gizmo.position = snapshot.p_ee

    def _drag_gizmo(self, event: viser.TransformControlsEvent) -> None:
        """Handle an event of the gizmo, whose phase is "start", "update" or "end"."""
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

        mesh.on_drag(self._notifier.guard(dragged))  # type: ignore[arg-type]
