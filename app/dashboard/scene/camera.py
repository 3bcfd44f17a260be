"""Camera of one viewer: views by name that show all of the robot, and following the base."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.drag import SCALE
from app.dashboard.scene.canvas import Lens
from app.dashboard.viser_compat import image_size
from app.simulation.trace.snapshot import GhostReading, Snapshot
from app.strict import Array

FIELD_OF_VIEW = np.deg2rad(42.0)  # [rad] vertical; longer than viser's 75°, so less distortion
_MARGIN = 0.10  # [-] of the free part that stays empty, both sides together
_ASPECTS = (0.4, 4.0)  # [-] that are believed
_MOST_COVERED = 0.25, 0.55  # [-] from above and from below
UP = np.array([0.0, 0.0, 1.0])
_LEAST_STEP = 1e-3  # [m] nobody sees less
_SAME = 0.02  # [m] nearer to where it was put nobody has moved a camera
_ECHO = 0.3  # [s] after which what comes back from a browser holds what was set
_PATIENCE = 6.0  # [s] after which nothing is waited for any more
_LEAST_SHARE = 0.05  # [-] of the picture's height; a robot that looks smaller is not found
_MOVED = 0.2  # [m] of the base, from which on who follows it wants to see it
_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
_HAND = 0.12 * _CORNERS  # [m] what has to be seen around the hand
_NEAR_HAND = 0.22 * _CORNERS  # [m] the same if the hand alone is looked at
_NEAR_PAIR = 0.30 * _CORNERS  # [m] the same around closest points
_FAR = 1.5  # [m] from the robot that is led; a ghost that is farther away is left behind
_OPEN = np.deg2rad(90.0)  # [rad] of a door for whose way there is room in the picture
_OVER_DOOR = 0.15  # [m] where its angle is written
_BACK = 1e-3  # [s] that time goes back where a run begins anew


class Window(NamedTuple):
    """The part of a page in which a scene is drawn."""

    aspect: float = 1.5
    """[-] its width over its height."""
    covered: float = 0.0
    """[-] share of its height, from below, that something else lies over."""
    above: float = 0.0
    """[-] the same from above."""

    @classmethod
    def of(cls, width: float, height: float, above: float = 0.0, below: float = 0.0) -> Window:
        """Of what a browser says of itself, which may be nothing yet; `above` and `below` [-]."""
        if not (0 < width < np.inf and 0 < height < np.inf and above >= 0 and below >= 0):
            return ANY_WINDOW
        aspect = float(np.clip(width / height, *_ASPECTS))
        above, below = np.clip((above, below), 0.0, _MOST_COVERED)
        return cls(aspect, float(below), float(above))

    @property
    def edges(self) -> tuple[float, float]:
        """[-] of the free part, from below and from above: −1 and 1 are those of the picture."""
        return 2.0 * self.covered - 1.0, 1.0 - 2.0 * self.above


ANY_WINDOW = Window()  # one that nothing is known of yet


class Preset(NamedTuple):
    """A way to look at the robot, in the base's frame."""

    away: Array
    """(3,) from what is looked at towards the camera."""
    of: Literal["robot", "hand", "pair", "door"] = "robot"
    """What is looked at: the whole robot, the hand alone, the hand and the closest points of the
    nearest pair, or the robot and a door with its hinge, from where a person stands who opens
    it."""


PRESETS = {
    "iso": Preset(np.array([1.5, 1.8, 1.0])),
    # Not quite from above: the camera's up direction has to be seen.
    "top": Preset(np.array([-0.01, 0.0, 3.3])),
    "front": Preset(np.array([2.9, 0.0, 0.22])),
    "side": Preset(np.array([0.0, -3.1, 0.22])),
    "hand": Preset(np.array([0.55, 0.75, 0.45]), "hand"),
    "pair": Preset(np.array([0.9, 1.2, 0.7]), "pair"),
    "door": Preset(np.array([-1.3, -0.8, 1.5]), "door"),
}
"""Views by name."""


class _Look(NamedTuple):
    """A preset that was looked from."""

    name: str
    window: Window | None
    """Where the picture was to be drawn then; None once the viewer has moved the camera."""
    eye: Array
    """(3,) [m] where the camera was put, and has been carried to since."""


class Camera:
    """Moves the camera of one client.

    What is set here comes back from the browser after a while, and with it what the viewer has
    done meanwhile. So one step after the other: a step from a place that is still on its way to
    the browser would be lost.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._extent = np.zeros((1, 3))
        self._looked: _Look | None = None
        self._arrived = False
        self._preset = "iso"
        self._before: Snapshot | None = None
        self._seen_at: Array | None = None
        self._begun = False  # anew, and not found since
        self._followed: Array | None = None
        self._set: Array | None = None
        self._set_at = 0.0
        self._from = np.zeros(3)  # where it was before what is on its way was set
        self._page = 0.0, 0.0, 0.0  # [px] what `cover` was told
        client.camera.on_update(self._hear)

    @property
    def window(self) -> Window:
        """Where the viewer's scene is drawn, as far as that is known."""
        height, above, below = self._page
        return Window.of(
            *image_size(self._client), above / max(height, 1.0), below / max(height, 1.0)
        )

    def cover(self, height: float, above: float, below: float) -> None:
        """Take what the page says of its scene: height, and what lies over it [px]."""
        self._page = float(height), float(above), float(below)

    @property
    def lens(self) -> Lens | None:
        """What is seen where; None while the browser has not said it."""
        camera, (_, drawn) = self._client.camera, image_size(self._client)
        height = self._page[0] or drawn
        if not 0.0 < height < np.inf:
            return None
        return lens_of(np.array(camera.position), np.array(camera.look_at), height, self.window)

    def fit(self, extent: Array) -> None:
        """From now on show a robot of this extent (N, 3) [m], in the base's frame."""
        self._extent = extent

    def begin(self, snapshot: Snapshot) -> None:
        """Look from where one looks at first."""
        self.use(first_view(snapshot), snapshot)

    def use(self, name: str, snapshot: Snapshot) -> None:
        """Look from a key of `PRESETS` at the robot as it is in a snapshot."""
        window, self._preset = self.window, name
        eye, target = placed(PRESETS[name], [snapshot], self._extent, window)
        self.put(eye, target)
        self._followed = np.array(snapshot.base_pose[:2])
        self._looked = _Look(name, window, np.array(eye))

    @property
    def preset(self) -> str:
        """The key of `PRESETS` from which the viewer still looks, or empty."""
        look, eye = self._looked, self._client.camera.position
        away = np.inf if look is None else np.linalg.norm(eye - look.eye)
        return self._preset if self._waits() or away < _SAME else ""

    def put(self, eye: Array, target: Array) -> None:
        """Look from a place (3,) [m] in the world at another one."""
        camera = self._client.camera
        if self._set is None:
            self._from = np.array(camera.position)
        with self._client.atomic():
            camera.up_direction = UP
            camera.position = eye
            camera.look_at = target
            camera.fov = FIELD_OF_VIEW
        self._followed = self._looked = None
        self._set, self._set_at, self._arrived = eye, monotonic(), False

    def settle(self, snapshot: Snapshot, *, busy: bool = False) -> None:
        """Look again if the page has taken another shape since, and nobody moved the camera.

        A page's panels come with its first picture, and narrow the scene only then; a drawer opens
        later. While the viewer is `busy` holding something, the scene must not move.
        """
        look, window = self._looked, self.window
        if look is None or look.window is None or busy:
            return
        if self._left(look):
            self._looked = look._replace(window=None)
        elif look.window != window:
            self.use(look.name, snapshot)

    def follow(self, base_position: Array, *, on: bool) -> None:
        """Carry the camera along by what the base (2,) [m] has moved since the last step.

        Off forgets where the base was.
        """
        if not on:
            self._followed = None
            return
        if self._followed is None:
            self._followed = np.array(base_position)
        step = np.append(base_position - self._followed, 0.0)
        if self._waits() or np.linalg.norm(step) < _LEAST_STEP:
            return
        self._followed, look = np.array(base_position), self._looked
        if look is not None:
            window = None if self._left(look) else look.window
            self._looked = look._replace(window=window, eye=look.eye + step)
        self._from = np.array(self._client.camera.position)
        self._set, self._set_at = self._from + step, monotonic()
        # Setting the position carries the point that is looked at along, by the same step.
        self._client.camera.position = self._set

    def find(self, snapshot: Snapshot, *, on: bool, busy: bool = False) -> None:
        """Look again where the robot has got out of sight; call it with each snapshot shown.

        That is after a beginning, whoever has moved the camera, and, if it follows, once the base
        has gone on unseen, or a hand, also of a ghost, where nobody has moved the camera. A
        scenario with a door begins with its view.

        Args:
            snapshot: What is shown.
            on: Whether the camera follows.
            busy: Whether the viewer holds something, under whom the scene must not move.
        """
        before, self._before = self._before, snapshot
        begun = before is not None and (
            snapshot.t < before.t - _BACK or (snapshot.scenario not in ("", before.scenario))
        )
        self._begun = self._begun or begun
        if begun and "door" in (first_view(snapshot), self._preset):
            self.begin(snapshot)
        if busy or self._waits():
            return
        camera, base_pose = self._client.camera, np.array(snapshot.base_pose)
        base = base_pose[:2]
        eye, target, window = camera.position, camera.look_at, self.window
        seen = sees(eye, target, _in_world(base_pose, self._extent), window)
        around = np.concatenate([robot.p_ee + _HAND for robot in _robots(snapshot)])
        lens = lens_of(eye, target, 1.0, window)
        hands = [lens.has(lens.pixel(corner)) for corner in around]
        if self._seen_at is None or seen:
            self._seen_at, self._begun = base, False
        elif self._begun or (on and np.linalg.norm(base - self._seen_at) > _MOVED):
            self.use(self._preset, snapshot)
        led = self.preset and PRESETS[self.preset].of in ("robot", "pair")
        if on and led and not all(hands):
            self.use(self._preset, snapshot)

    def _waits(self) -> bool:
        """Whether what was set may still be on its way to the browser."""
        return self._set is not None and monotonic() < self._set_at + _PATIENCE

    def _left(self, look: _Look) -> bool:
        """Whether the viewer has moved the camera away; unknown while a step is on its way."""
        away = float(np.linalg.norm(self._client.camera.position - look.eye))
        return self._arrived and self._set is None and away > _LEAST_STEP

    async def _hear(self, camera: viser.CameraHandle) -> None:
        """Something has come back: is it what was set, or later than that?"""
        there = self._set is not None and bool(
            np.linalg.norm(camera.position - self._set) < _LEAST_STEP
        )
        self._arrived = self._arrived or there
        # A slow browser says for seconds where it was before: what is set is on its way still.
        late = np.linalg.norm(camera.position - self._from) < _LEAST_STEP
        if there or (monotonic() > self._set_at + _ECHO and not late):
            self._set = None


def first_view(snapshot: Snapshot) -> str:
    """Key of `PRESETS` of the first view: a door's where there is one."""
    return "iso" if snapshot.door is None else "door"


def placed(
    preset: Preset, shown: Sequence[Snapshot], extent: Array, window: Window = ANY_WINDOW
) -> tuple[Array, Array]:
    """Eye and target of a preset (3,) [m] in the world, turned with the base.

    All that is `shown` one after the other is in the picture. `extent` are points (N, 3) [m] of
    the robot in its ready pose, in the base's frame.
    """
    about = shown[len(shown) // 2]
    away = pin.utils.rotate("z", about.base_pose[2]) @ preset.away
    if preset.of == "door" and about.door is not None:
        door = about.door.door
        away = door.pose(0.0).rotation @ (preset.away * (1.0, -door.side, 1.0))
    return fit(np.vstack([_to_see(preset.of, each, extent) for each in shown]), away, window)


def _to_see(of: str, snapshot: Snapshot, extent: Array) -> Array:
    """(N, 3) [m] what has to be in a picture of an instant; `of` as in `Preset`."""
    hand, robots = snapshot.p_ee, _robots(snapshot)
    seen = [_in_world(robot.base_pose, extent) for robot in robots]
    seen += [robot.p_ee + _HAND for robot in robots]
    if of == "hand":
        seen = [hand + _NEAR_HAND]
    elif of == "pair" and snapshot.pairs:
        nearest = snapshot.nearest
        seen = [p + _NEAR_PAIR for p in (nearest.p_a, nearest.p_b)] + seen[len(robots) :]
    elif of == "door" and snapshot.door is not None:
        door, (_, width, height) = snapshot.door.door, snapshot.door.door.size
        top = height + _OVER_DOOR
        corners = [(0.0, -door.side * u, v) for u in (0.0, width) for v in (0.0, top)]
        poses = (door.pose(0.0), door.pose(snapshot.door.angle), door.pose(_OPEN))
        seen.append(np.array([T.act(np.array(c)) for T in poses for c in corners]))
    return np.vstack([*seen, hand + SCALE * np.eye(3)])  # and the gizmo's tips


def lens_of(eye: Array, target: Array, height: float, window: Window) -> Lens:
    """Of a camera at a place (3,) [m] that looks at another one, in a picture so many [px] high."""
    half, (low, high) = height / 2, window.edges
    free = -half * window.aspect, half * low, half * window.aspect, half * high
    return Lens(eye, _axes(target - eye), half / np.tan(FIELD_OF_VIEW / 2), free)


def sees(eye: Array, target: Array, points: Array, window: Window) -> bool:
    """Whether the middle of points (N, 3) [m] is in the free part of a picture, large enough."""
    lens, middle = lens_of(eye, target, 1.0, window), points.mean(axis=0)
    pixel = lens.pixel(middle)
    size = float(np.linalg.norm(points - middle, axis=1).max())
    return lens.has(pixel) and size >= _LEAST_SHARE * np.tan(FIELD_OF_VIEW / 2) * pixel[2]


def _robots(snapshot: Snapshot) -> list[Snapshot | GhostReading]:
    """The robot that is led, and the ghosts beside it that are to be seen with it."""
    away = [np.linalg.norm((ghost.base_pose - snapshot.base_pose)[:2]) for ghost in snapshot.ghosts]
    return [snapshot, *(g for g, d in zip(snapshot.ghosts, away, strict=True) if d < _FAR)]


def _in_world(base_pose: Array, extent: Array) -> Array:
    """(N, 3) [m] points of a robot in its base's frame, in the world."""
    x, y, phi = base_pose
    return np.array([x, y, 0.0]) + extent @ pin.utils.rotate("z", phi).T


def _axes(forward: Array) -> Array:
    """(3, 3) right, up and forward of a camera that looks along a direction; not upright."""
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    return np.array([right, np.cross(right, forward), forward])


def set_first_look(server: viser.ViserServer, eye: Array, target: Array) -> None:
    """Where new viewers of a server look from at first, (3,) [m] in the world each."""
    camera = server.initial_camera
    camera.position, camera.look_at, camera.fov = eye, target, FIELD_OF_VIEW


def fit(points: Array, away: Array, window: Window) -> tuple[Array, Array]:
    """The nearest camera that sees all points, in the middle of the free part.

    `away` (3,) is from the points (N, 3) [m] towards the camera; not upright.

    Returns:
        (3,) [m] the eye, and (3,) [m] a point before it on the middle of the picture, as far away
        as the middle of the points.
    """
    axes = _axes(-away)
    forward = axes[2]
    u, v, depth = axes @ points.T
    high = np.tan(FIELD_OF_VIEW / 2)
    across = _Strip(u, depth, -high * window.aspect, high * window.aspect)
    low, top = window.edges
    along = _Strip(v, depth, low * high, top * high)
    nearest = min(across.nearest, along.nearest)
    eye = axes.T @ np.array([across.middle(nearest), along.middle(nearest), nearest])
    return eye, eye + ((depth.min() + depth.max()) / 2 - nearest) * forward


class _Strip:
    """What one direction of the picture asks of the camera.

    A point at u and depth w is seen at (u − u₀)/(w − w₀) from a camera at u₀, w₀, which has to be
    between low and high: two half-planes of (u₀, w₀) a point.
    """

    def __init__(self, u: Array, depth: Array, low: float, high: float) -> None:
        spare = _MARGIN / 2 * (high - low)
        self._low, self._high = low + spare, high - spare
        self._least = float(np.max(u - self._high * depth))
        self._most = float(np.min(u - self._low * depth))

    @property
    def nearest(self) -> float:
        """[m] the depth of the camera that is nearest to the points."""
        return (self._most - self._least) / (self._high - self._low)

    def middle(self, depth: float) -> float:
        """[m] where a camera at a depth has as much room on either side."""
        return (self._least + self._high * depth + self._most + self._low * depth) / 2
