"""Canvas: points, lines, arrows, boxes and labels that each picture draws anew."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin
import trimesh
import viser

from app.dashboard.scene.colours import Rgb, linear
from app.strict import Array

Anchor = Literal["bottom-left", "top-left", "bottom-right", "top-right", "bottom-center"]

ROOT = "/robot"  # scene node at the base's position on the floor; its x axis points forward
HEAD_LENGTH = 0.035  # [m] of an arrow's head
ANCHORS: tuple[Anchor, ...] = get_args(Anchor)  # of a label, the preferred one first
FONT_SCALE = 0.85  # [-] size of labels, whose characters are then 12 px high
LINE, CHARACTER = 15.0, 5.6  # [px] height of a label's line, width of a character
_BEFORE = {"left": 0.0, "center": 0.5, "right": 1.0}  # [-] part of a label left of its position
_SMALL, _LARGEST = 800.0, 1.6  # [px] height above which labels are larger; [-] largest factor
_FARTHEST = 8  # [lines] largest shift of a label


class Lens(NamedTuple):
    """Projection of the scene to a viewer's picture."""

    eye: Array  # (3,) [m] position of the camera
    axes: Array  # (3, 3) right, up and forward axis of the camera
    focal: float  # [px] focal length
    free: tuple[float, float, float, float]
    """[px] left, lower, right and upper edge of the uncovered part, in coordinates of `pixel`."""

    def pixel(self, places: Array) -> tuple[Any, Any, Any]:
        """Project points (3,) or (N, 3) [m]: return [px] to the right, [px] up, and depth [m]."""
        u, v, depth = self.axes @ (places - self.eye).T
        scale = self.focal / np.maximum(depth, 1e-3)
        return scale * u, scale * v, depth

    def has(self, pixel: tuple[float, float, float]) -> bool:
        """Whether a result of `pixel` is in front of the camera and in the uncovered part."""
        (u, v, depth), (left, low, right, high) = pixel, self.free
        return bool(depth > 0.0 and left < u < right and low < v < high)


class Spot(NamedTuple):
    """Position of a label relative to its point."""

    anchor: Anchor  # point of the label that is at the shifted point
    rise: float = 0.0  # [px] upward shift of the point


def set_apart(
    labels: Mapping[str, tuple[float, float, str]],
    before: Mapping[str, Spot],
    free: tuple[float, float, float, float],
    scale: float = 1.0,
) -> dict[str, Spot]:
    """Choose spots for labels so that they do not overlap; earlier labels choose first.

    A label without a free spot gets the first spot, and can overlap others. `before` has the spots
    of the previous picture, which need less free space, so that labels rarely jump. `labels` has
    coordinates [px] to the right and up, and text, by the label's name.
    `free` has the left, lower, right and upper edge [px] of the area for labels. `scale` [-] is the
    size of the labels relative to `FONT_SCALE`.
    """
    lines = sorted(range(-_FARTHEST, _FARTHEST + 1), key=abs)
    spots = [Spot(anchor, scale * LINE * k) for k in lines for anchor in ANCHORS]
    found: dict[str, Spot] = {}
    taken: list[tuple[float, float, float, float]] = []
    for name, (u, v, text) in labels.items():
        rows = text.split("\n")
        wide = scale * CHARACTER * (max(map(len, rows)) + 1)
        tall = scale * LINE * len(rows)
        for k, spot in enumerate((*spots, spots[0])):
            room = 0.0 if spot == before.get(name) else 4.0  # [px] avoids jumps
            left = u - wide * _BEFORE[spot.anchor.partition("-")[2]]
            low = v + spot.rise - (0.0 if spot.anchor.startswith("bottom") else tall)
            inside = free[0] <= left <= free[2] - wide and free[1] <= low <= free[3] - tall
            apart = all(
                not (-wide - room < left - x < w + room and -tall - room < low - y < h + room)
                for x, y, w, h in taken
            )
            if (inside and apart) or k == len(spots):
                break
        taken.append((left, low, wide, tall))
        found[name] = spot
    return found


class Canvas:
    """Shows the objects that were drawn in the last picture, and hides all others.

    An object `parent/object` is in the frame of its parent node, but labels are in the world.
    """

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self.labels = True  # whether labels are drawn; a browser renders them after the picture
        self._handles: dict[str, Any] = {}
        self._drawn: set[str] = set()
        self._texts = True
        self._places: dict[str, tuple[Array, str]] = {}  # positions and texts of labels
        self._spots: dict[str, Spot] = {}
        self._t = 0.0

    @contextmanager
    def picture(self, *, texts: bool, lens: Lens | None = None, t: float = 0.0) -> Iterator[None]:
        """Show only objects drawn in this context; change texts of old labels only if `texts`.

        With a lens, labels get spots by `set_apart`. They prefer their last spots while the
        simulated time `t` [s] advances in short steps.
        """
        if not 0.0 < t - self._t < 0.5:  # [s] otherwise this is another motion
            self._spots = {}
        self._drawn, self._texts, self._places, self._t = set(), texts, {}, t
        yield
        self._set_labels(lens)
        for name, handle in self._handles.items():
            handle.visible = name in self._drawn

    def point(self, name: str, place: Array, colour: Rgb, radius: float) -> None:
        """Draw a ball of a radius [m] at a position (3,) [m]; later calls only move it."""
        add = self._scene.add_icosphere
        node = self._node(name, add, radius=radius, color=colour, cast_shadow=False)
        node.position = place

    def label(self, name: str, place: Array, text: str) -> None:
        """Draw a text at a point (3,) [m] in the world; earlier labels choose their spots first."""
        if self.labels:
            node = self._node(name, self._scene.add_label, text, anchor=ANCHORS[0])
            if self._texts:
                node.text = text
            self._places[name] = place, node.text

    def lines(self, name: str, lines: Sequence[Array], colour: Rgb, pixels: float) -> None:
        """Draw lines, each through points (K, 3) [m], K ≥ 2; `pixels` is the width."""
        ends = np.concatenate([np.stack([each[:-1], each[1:]], axis=1) for each in lines])
        self.segments(name, ends, np.array(colour, np.uint8), pixels)

    def segments(self, name: str, ends: Array, colours: Array, pixels: float) -> None:
        """Draw straight segments between their ends (N, 2, 3) [m]; `pixels` is the width.

        Colours are uint8: (3,) in sRGB for all segments, or (N, 2, 3) in linear colours. All
        calls with one `name` need colours of one shape: otherwise viser can draw white lines.
        """
        look = {"thickness": pixels, "thickness_units": "screen"}
        node = self._node(name, self._scene.add_line_segments, ends, colours, **look)
        node.colors = colours
        node.points = ends

    def arrow(self, name: str, start: Array, end: Array, colour: Rgb) -> None:
        """Draw an arrow between two points (3,) [m]; later calls do not change its colour."""
        ends = np.array([[start, end]])
        look = {"shaft_radius": 0.008, "head_radius": 0.020, "head_length": HEAD_LENGTH}
        shade = linear(np.array([colour]))[0]
        node = self._node(name, self._scene.add_arrows, ends, shade, **look)
        node.points = ends

    def box(
        self, name: str, T: pin.SE3, size: Sequence[float], colour: Rgb, opacity: float | None
    ) -> None:
        """Draw a box of a size (3,) [m] with its centre at the pose T."""
        node = self._node(name, self._scene.add_box, color=colour, opacity=opacity)
        node.dimensions = tuple(map(float, size))
        node.position, node.wxyz = to_viser(T)

    def _set_labels(self, lens: Lens | None) -> None:
        seen = {
            name: (*pixel[:2], text)
            for name, (place, text) in self._places.items()
            if lens is not None and lens.has(pixel := lens.pixel(place))
        }
        high = _SMALL if lens is None else lens.free[3] - lens.free[1]
        scale = min(max(round(high / _SMALL, 1), 1.0), _LARGEST)
        self._spots = {} if lens is None else set_apart(seen, self._spots, lens.free, scale)
        for name, (place, _) in self._places.items():
            spot, handle = self._spots.get(name, Spot(ANCHORS[0])), self._handles[name]
            if lens is not None and spot.rise:
                place = place + spot.rise * lens.pixel(place)[2] / lens.focal * lens.axes[1]
            handle.position, handle.anchor = place, spot.anchor
            handle.font_screen_scale = scale * FONT_SCALE

    def _node(self, name: str, add: Callable[..., Any], *values: Any, **look: Any) -> Any:
        """Mark the scene node `name` as drawn, and return it; add it by `add` if it is missing."""
        self._drawn.add(name)
        if name not in self._handles:
            self._handles[name] = add(name, *values, visible=False, **look)
        return self._handles[name]


def add_mesh(
    scene: viser.SceneApi, name: str, mesh: trimesh.Trimesh, T: pin.SE3, **look: Any
) -> viser.MeshHandle:
    """Add a mesh at its pose T in the parent node; `look` has more arguments of viser."""
    vertices, faces, (position, wxyz) = mesh.vertices, mesh.faces, to_viser(T)
    return scene.add_mesh_simple(
        name, np.asarray(vertices), np.asarray(faces), position=position, wxyz=wxyz, **look
    )


def to_viser(T: pin.SE3) -> tuple[Array, Array]:
    """Return position (3,) [m] and unit quaternion wxyz (4,) of a pose."""
    xyzquat = np.array(pin.SE3ToXYZQUAT(T))
    return xyzquat[:3], xyzquat[[6, 3, 4, 5]]


def in_world(base_pose: Array, points: Array) -> Array:
    """Transform points (..., 3) [m] from the base's frame (node `ROOT`) to the world."""
    x, y, phi = base_pose
    return points @ pin.utils.rotate("z", phi).T + (x, y, 0.0)
