"""Camera of one viewer: named views of the robot, and a mode that follows the base."""

from collections.abc import Sequence
from time import monotonic
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.drag import SCALE
from app.dashboard.scene.canvas import Lens, in_world
from app.dashboard.viser_compat import image_size
from app.simulation.trace.snapshot import GhostReading, Snapshot
from app.strict import Array

FIELD_OF_VIEW = np.deg2rad(42.0)  # [rad] vertical; less distortion than viser's 75°
_MOST_COVERED = 0.8, 0.55  # [-] limits of the shares that are covered in all and from below
UP = np.array([0.0, 0.0, 1.0])
_LEAST_STEP = 1e-3  # [m] smaller steps of the camera are invisible
_PATIENCE = 6.0  # [s] timeout of the browser's confirmation
_MOVED = 0.2  # [m] motion of an unseen base after which a following camera moves
_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)  # (8, 3) of a cube
_AROUND = 0.12 * _CORNERS  # [m] space to show around the end-effector
_NEAR_EE = 0.22 * _CORNERS  # [m] the same in the view of the end-effector alone
_NEAR_PAIR = 0.30 * _CORNERS  # [m] space to show around closest points
_FAR = 1.5  # [m] ghosts farther away from the main robot need not be in the picture


class Window(NamedTuple):
    """The area of a page that shows the scene; cards and drawers can cover its top and bottom."""

    aspect: float = 1.5  # [-] ratio of width to height
    covered: float = 0.0  # [-] share of the height that is covered from below
    above: float = 0.0  # [-] share of the height that is covered from above

    @classmethod
    def of(cls, width: float, height: float, above: float = 0.0, below: float = 0.0) -> "Window":
        """Return a window, within limits, from sizes [px] and covered shares [-] of a page."""
        if not (0 < width < np.inf and 0 < height < np.inf and above >= 0 and below >= 0):
            return cls()  # at first, the sizes of a page are 0
        aspect, covered = min(max(width / height, 0.4), 4.0), min(below, _MOST_COVERED[1])
        return cls(aspect, covered, min(above, _MOST_COVERED[0] - covered))

    @property
    def edges(self) -> tuple[float, float]:
        """Lower and upper edge [-] of the uncovered part; the picture is from −1 to 1."""
        return 2.0 * self.covered - 1.0, 1.0 - 2.0 * self.above


class Preset(NamedTuple):
    """A view; `away` is in the base's frame, or in a closed door's frame for the target "door"."""

    away: Array  # (3,) direction from the target to the camera
    of: Literal["robot", "end-effector", "pair", "door"] = "robot"
    """Target: the whole robot; the end-effector alone; the end-effector and the closest points of
    the nearest pair; or robot and door. Without a door, "door" is the whole robot."""


PRESETS = {  # by name
    "iso": Preset(np.array([1.5, 1.8, 1.0])),
    # Not exactly from above, because the camera's up direction must not be parallel to the view.
    "top": Preset(np.array([-0.01, 0.0, 3.3])),
    "front": Preset(np.array([2.9, 0.0, 0.22])),
    "side": Preset(np.array([0.0, -3.1, 0.22])),
    "end-effector": Preset(np.array([0.55, 0.75, 0.45]), "end-effector"),
    "pair": Preset(np.array([0.9, 1.2, 0.7]), "pair"),
    "door": Preset(np.array([-1.3, -0.8, 1.5]), "door"),
}


class Camera:
    """Moves the camera of one client.

    The browser reports each new position after a delay, together with the viewer's own changes. So
    that no change is lost, `follow` and `find` return early until this report, or `_PATIENCE`.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self.extent: Array = np.zeros((1, 3))  # (N, 3) [m] points to show, in the base's frame
        self.wanted = ""  # preset that the next call of `settle` uses
        self._preset = "iso"  # the preset that was used last
        self._eye = np.full(3, np.inf)  # [m] the preset's position, moved along with the base
        self._fitted: Window | None = None  # the preset's window; None if a viewer moved the camera
        self._arrived = False
        self._before: Snapshot | None = None
        self._seen_at: Array | None = None
        self._begun = False  # a run has started, and the robot was not seen since
        self._followed: Array | None = None
        self._set: Array | None = None
        self._set_at = 0.0
        self._from = np.zeros(3)  # [m] position before the unconfirmed one was set
        self._page = 0.0, 0.0, 0.0  # [px] arguments of `cover`
        client.camera.on_update(self._hear)

    @property
    def window(self) -> Window:
        """Shape and covered parts of the scene, as last stated by the browser."""
        height, above, below = self._page
        whole = max(height, 1.0)
        return Window.of(*image_size(self._client), above / whole, below / whole)

    def cover(self, height: float, above: float, below: float) -> None:
        """Store the page's report: heights [px] of the scene and of its covered ends."""
        self._page = height, above, below

    @property
    def lens(self) -> Lens | None:
        """Projection of the scene, or None while its height is unknown."""
        camera, (_, drawn) = self._client.camera, image_size(self._client)
        height = self._page[0] or drawn
        if not 0.0 < height < np.inf:
            return None
        return lens_of(np.array(camera.position), np.array(camera.look_at), height, self.window)

    def begin(self, snapshot: Snapshot) -> None:
        self.use(first_view(snapshot), snapshot)

    def use(self, name: str, snapshot: Snapshot) -> None:
        """Look at the robot of a snapshot from the preset `name`, a key of `PRESETS`."""
        camera, self._fitted, self._preset = self._client.camera, self.window, name
        eye, target = placed(PRESETS[name], [snapshot], self.extent, self._fitted)
        if self._set is None:
            self._from = np.array(camera.position)
        with self._client.atomic():
            camera.up_direction = UP
            camera.position = eye
            camera.look_at = target
            camera.fov = FIELD_OF_VIEW
        self._set, self._set_at, self._arrived = eye, monotonic(), False
        self._eye, self._followed = np.array(eye), np.array(snapshot.base_pose[:2])

    @property
    def preset(self) -> str:
        """The key of the preset in use; empty once the viewer has moved the camera."""
        away = np.linalg.norm(self._client.camera.position - self._eye)
        return self._preset if self._waits() or away < 0.02 else ""  # [m]

    def settle(self, snapshot: Snapshot, *, busy: bool = False) -> None:
        """Use the preset in `wanted`, if any; fit the last one again if the window has changed.

        There is no such fit during a pull (`busy`), or after the viewer has moved the camera.
        """
        wanted, self.wanted = self.wanted, ""
        if wanted:
            self.use(wanted, snapshot)
        if self._fitted is None or busy:
            return
        if self._left():
            self._fitted = None
        elif self._fitted != self.window:
            self.use(self._preset, snapshot)

    def follow(self, base_position: Array, *, on: bool) -> None:
        """Move the camera with the base at `base_position` (2,) [m] in the world, if `on`."""
        if not on:
            self._followed = None
            return
        if self._followed is None:
            self._followed = np.array(base_position)
        step = np.append(base_position - self._followed, 0.0)
        if self._waits() or np.linalg.norm(step) < _LEAST_STEP:
            return
        if self._left():
            self._fitted = None
        self._followed, self._eye = np.array(base_position), self._eye + step
        self._from = np.array(self._client.camera.position)
        self._set, self._set_at = self._from + step, monotonic()
        # viser moves the target by the same step as the position.
        self._client.camera.position = self._set

    def find(self, snapshot: Snapshot, *, on: bool, busy: bool = False) -> None:
        """Use the last preset again if the robot is out of sight; call this method regularly.

        Without a pull (`busy`), this happens in three cases: the robot was not in sight since the
        start of the run; the camera follows (`on`), and the base has moved by more than `_MOVED`
        out of sight; the camera follows, still has a preset of the whole robot or of the pair, and
        does not show the end-effector of the robot or of a near ghost. A run with a door starts
        with the preset "door", also during a pull; a run without a door replaces "door" by "iso".
        """
        before, self._before = self._before or snapshot, snapshot
        begun = not snapshot.follows(before) or snapshot.scenario not in ("", before.scenario)
        self._begun |= begun
        if begun and "door" in (first_view(snapshot), self._preset):
            self.begin(snapshot)
        if busy or self._waits():
            return
        camera, base = self._client.camera, np.array(snapshot.base_pose[:2])
        eye, target, window = camera.position, camera.look_at, self.window
        lens = lens_of(eye, target, 1.0, window)
        around = np.concatenate([robot.p_ee + _AROUND for robot in _robots(snapshot)])
        shown = all(lens.has(lens.pixel(corner)) for corner in around)
        seen = sees(eye, target, in_world(snapshot.base_pose, self.extent), window)
        if self._seen_at is None or seen:
            self._seen_at, self._begun = base, False
        elif self._begun or (on and np.linalg.norm(base - self._seen_at) > _MOVED):
            self.use(self._preset, snapshot)
        preset = self.preset  # the thread that receives messages can change it
        if on and preset and PRESETS[preset].of in ("robot", "pair") and not shown:
            self.use(self._preset, snapshot)

    def _waits(self) -> bool:
        """Whether the browser has yet to confirm the last position; False after `_PATIENCE`."""
        return self._set is not None and monotonic() < self._set_at + _PATIENCE

    def _left(self) -> bool:
        """Whether the viewer has moved the camera; False until the browser confirms a position."""
        moved = not _near(self._client.camera.position, self._eye)
        return self._arrived and self._set is None and moved

    async def _hear(self, camera: viser.CameraHandle) -> None:
        there = self._set is not None and _near(camera.position, self._set)
        self._arrived |= there
        # A slow browser reports its old position for seconds: the new one has not arrived yet.
        late = _near(camera.position, self._from)
        if there or (monotonic() > self._set_at + 0.3 and not late):  # [s] for the answer
            self._set = None


def _near(a: Array, b: Array) -> bool:
    return bool(np.linalg.norm(a - b) < _LEAST_STEP)


def first_view(snapshot: Snapshot) -> Literal["iso", "door"]:
    """Return the key of the preset at the start of a run: "door" with a door, else "iso"."""
    return "iso" if snapshot.door is None else "door"


def placed(
    preset: Preset, shown: Sequence[Snapshot], extent: Array, window: Window | None = None
) -> tuple[Array, Array]:
    """Return eye and target (3,) [m] of a preset in the world.

    The picture shows the target `Preset.of` in all snapshots, at least one. The direction is
    relative to the base in the middle snapshot, or to the closed door if the target is "door".
    `extent` has points (N, 3) [m] of the robot in its ready posture, in the base's frame.
    """
    about = shown[len(shown) // 2]
    away = pin.utils.rotate("z", about.base_pose[2]) @ preset.away
    if preset.of == "door" and about.door is not None:
        door = about.door.door
        away = door.pose(0.0).rotation @ (preset.away * (1.0, -door.side, 1.0))
    points = np.vstack([_to_see(preset.of, each, extent) for each in shown])
    return fit(points, away, window or Window())


def _to_see(of: str, snapshot: Snapshot, extent: Array) -> Array:
    """Return the points (N, 3) [m] that a picture of a snapshot must show; `of` as in `Preset`."""
    ee, robots = snapshot.p_ee, _robots(snapshot)
    seen = [in_world(robot.base_pose, extent) for robot in robots]
    seen += [robot.p_ee + _AROUND for robot in robots]
    if of == "end-effector":
        seen = [ee + _NEAR_EE]
    elif of == "pair" and snapshot.pairs:
        nearest = snapshot.nearest
        seen = [p + _NEAR_PAIR for p in (nearest.p_a, nearest.p_b)] + seen[len(robots) :]
    elif of == "door" and snapshot.door is not None:
        door, (_, width, height) = snapshot.door.door, snapshot.door.door.size
        top = height + 0.15  # [m] with the label above the door
        corners = [(0.0, -door.side * u, v) for u in (0.0, width) for v in (0.0, top)]
        poses = (door.pose(0.0), door.pose(snapshot.door.angle), door.pose(np.deg2rad(90.0)))
        seen.append(np.array([T.act(np.array(c)) for T in poses for c in corners]))
    return np.vstack([*seen, ee + SCALE * np.eye(3)])  # includes the gizmo's tips


def lens_of(eye: Array, target: Array, height: float, window: Window) -> Lens:
    """Return the projection of a camera from `eye` to `target` in a picture of a height [px]."""
    half, (low, high) = height / 2, window.edges
    free = -half * window.aspect, half * low, half * window.aspect, half * high
    return Lens(eye, _axes(target - eye), half / np.tan(FIELD_OF_VIEW / 2), free)


def sees(eye: Array, target: Array, points: Array, window: Window) -> bool:
    """Whether the mean of points (N, 3) [m] is in the free part, and their image is not tiny."""
    lens, middle = lens_of(eye, target, 1.0, window), points.mean(axis=0)
    pixel = lens.pixel(middle)
    size = float(np.linalg.norm(points - middle, axis=1).max())
    return lens.has(pixel) and size >= 0.05 * np.tan(FIELD_OF_VIEW / 2) * pixel[2]


def _robots(snapshot: Snapshot) -> list[Snapshot | GhostReading]:
    away = [np.linalg.norm((ghost.base_pose - snapshot.base_pose)[:2]) for ghost in snapshot.ghosts]
    return [snapshot, *(g for g, d in zip(snapshot.ghosts, away, strict=True) if d < _FAR)]


def _axes(forward: Array) -> Array:
    """Return the right, up and forward axes (3, 3) of a camera, which must not look vertically."""
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, forward), forward])


def set_first_look(server: viser.ViserServer, eye: Array, target: Array) -> None:
    """Set eye and target (3,) [m], in the world, of the camera with which a new viewer starts."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.fov = eye, target, FIELD_OF_VIEW


def fit(points: Array, away: Array, window: Window) -> tuple[Array, Array]:
    """Return the nearest camera that shows all points (N, 3) [m], centred in the free part.

    `away` (3,) is the direction from the points to the camera, not vertical. Returns the eye (3,)
    [m], and a target (3,) [m] on the optical axis at the middle of the points' depths.
    """
    axes = _axes(-away)
    across, depth = np.vsplit(axes @ points.T, [2])
    free = np.array([(-window.aspect, window.aspect), window.edges])
    low, high = np.tan(FIELD_OF_VIEW / 2) * free.T
    spare = 0.05 * (high - low)  # a margin on each side
    low, high = low + spare, high - spare
    # A camera at coordinate u_0 and depth w_0 shows a point at (u - u_0)/(w - w_0). This is between
    # `low` and `high`: in each direction, all points give two half-planes of (u_0, w_0).
    least = (across - high[:, None] * depth).max(axis=1)
    most = (across - low[:, None] * depth).min(axis=1)
    nearest = float(((most - least) / (high - low)).min())
    middle = (least + high * nearest + most + low * nearest) / 2  # equal margins on both sides
    eye = axes.T @ np.array([*middle, nearest])
    return eye, eye + ((depth.min() + depth.max()) / 2 - nearest) * axes[2]
