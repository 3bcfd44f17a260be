"""Borders: clouds or bodies of colour that move with the base, and their slice at the arm."""

import io
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
import viser
from PIL import Image
from trimesh.visual.material import PBRMaterial

from app.avoidance.acting_point import (
    ActingPointFinder,
    avoidance_force,
    resultant_force,
)
from app.border.dbb import Cloud, construct_dbb
from app.border.mobile import MobileBody
from app.border.nearest import BorderSearch
from app.border.offset import OffsetContours, offset_contours
from app.border.score import ScoreField
from app.config import BorderConfig
from app.dashboard.scene.canvas import ROOT, Canvas
from app.dashboard.scene.colours import ACTING, Rgb, viridis
from app.dashboard.scene.layers import draw_acceleration
from app.dashboard.scene.legend import Legend, measure_of
from app.dashboard.view import HIDDEN, View
from app.robot.bases.kind import planar
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot
from app.strict import Array

MAX_POINTS = 20_000
"""Points drawn; more of them only hide what lies behind and slow the browser down."""
LIGHT_POINTS = 4000  # the same where a page draws in software
_KEPT = 32  # clouds that are kept for other viewers
POINT_SIZE = 0.0035  # [m] small enough to see the acting points behind it
LIGHT_SIZE = 0.006  # [m] of one of few points
_GRAIN = 0.002  # [m] of height by which the slice has to change to be sent anew
_EVERY = 3  # rays of the contour between two drawn points
_ON_DARK: Rgb = (255, 255, 255)
_ON_LIGHT: Rgb = (20, 24, 30)
_RAYS = 3  # rays of a contour between two columns of the shell
_HEIGHTS = 2  # contours between two of its rows
_OPACITY = 0.42  # [-]
_SHADES = 256  # of the colours on it
_INSIDE = 0.5  # [-] of d_b: how near the base the arm is taken to be where it is clicked


class ColouredCloud(NamedTuple):
    """A border as it is sent to a browser: (N, 3) [m] in the base's frame, and (N, 3) uint8."""

    points: Array
    colours: Array
    legend: Legend


class Borders:
    """Selects borders from the stored clouds; what one viewer has asked for, the next finds."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud]) -> None:
        """Nothing is selected yet; `clouds` are P_i of every pair of L_m, by the pair's name."""
        self.pairs = frozenset(clouds)
        """Names of the pairs of L_m."""
        self.top = float(MobileBody(model).upper[2])
        """[m] height of the base's top; what lies above it is drawn on demand only."""
        self._model, self._clouds = model, clouds
        # A pair of L_m is named `lm-<body of the arm>`.
        self.fields = {pair: ScoreField.of(model, pair.partition("-")[2]) for pair in clouds}
        """Their scores, by the pair."""
        self._kept: dict[tuple[object, ...], Any] = {}

    def coloured(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        """A border's points with the colours of a quantity; None if it has no points.

        The quantity is one of `app.dashboard.scene.legend.QUANTITIES`; `whole` takes in what lies
        above the base's top.
        """
        return self._keep(
            (pair, quantity, border.d_b, border.eps, whole),
            lambda: self._colour(pair, quantity, border, whole=whole),
        )

    def surface(self, border: BorderConfig) -> OffsetContours:
        """The border as contours, which is that of every pair."""
        return offset_contours(self._model, border.d_b)

    def values(self, pair: str, quantity: str, points: Array) -> Array:
        """(N,) a quantity, one of `QUANTITIES`, at points (N, 3) [m] in the base's frame."""
        field = self.fields[pair]
        return {
            "determinant": field.singularity,
            "reachability": field.reachability,
            "score": field.score,
        }[quantity](points)

    def _keep(self, key: tuple[object, ...], make: Callable[[], Any]) -> Any:
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = make()
        return self._kept[key]

    def _colour(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        points = construct_dbb(self._clouds[pair], border.d_b, border.eps).points
        if not whole:
            points = points[points[:, 2] <= self.top]
        if not len(points):
            return None
        values = self.values(pair, quantity, points)
        keep = subsample(len(points), MAX_POINTS)
        top = None if whole else self.top
        base = self._model.description.base
        legend = Legend.of(pair, quantity, base, border.d_b, values, len(keep), top)
        return ColouredCloud(points[keep], viridis(legend.normalised(values[keep])), legend)


def subsample(total: int, most: int) -> Array:
    """Indices of at most `most` points out of `total`, always the same, in no visible pattern."""
    if total <= most:
        return np.arange(total)
    return np.random.default_rng(0).permutation(total)[:most]


class Probe(NamedTuple):
    """What holds at a place of the border, in the base's frame."""

    p: Array
    """(3,) [m] the place."""
    det: float
    reach: float
    score: float
    """Of (7), (9) and (10) there."""
    p_act: Array
    """(3,) [m] acting point of an arm that is halfway in there."""
    acceleration: Array
    """(n_b,) of the base for it, by (16)."""


class _Drawn(NamedTuple):
    """What of a pair's border is there: nothing where it is hidden or has no points."""

    wanted: tuple[object, ...]
    legend: Legend | None = None
    node: viser.PointCloudHandle | viser.GlbHandle | None = None
    body: trimesh.Trimesh | None = None


class DrawnBorders:
    """Draws each pair's border anew whenever its quantity, d_b, ε or kind has changed.

    It is a cloud of points, or a translucent body, of which a click tells what holds there.
    """

    def __init__(self, scene: viser.SceneApi, borders: Borders, model: RobotModel) -> None:
        self._scene, self._borders, self._model = scene, borders, model
        self._drawn: dict[str, _Drawn] = {}
        self._clicked: tuple[Array, Array] | None = None
        self._probed: tuple[str, Probe] | None = None

    @property
    def legends(self) -> list[Legend]:
        """Of the borders that are drawn."""
        return [drawn.legend for drawn in self._drawn.values() if drawn.legend is not None]

    def update(self, view: View, border: BorderConfig) -> bool:
        """Redraw what has changed.

        Returns:
            Whether something has, and `legends` is new.
        """
        changed = False
        for pair, quantity in view.borders.items():
            wanted = (quantity, view.whole_border, view.light, view.shell, border.d_b, border.eps)
            if pair not in self._drawn or self._drawn[pair].wanted != wanted:
                self._drawn[pair] = self._draw(pair, wanted, view, border)
                changed = True
        return changed

    def _draw(
        self, pair: str, wanted: tuple[object, ...], view: View, config: BorderConfig
    ) -> _Drawn:
        quantity, before, coloured = view.borders[pair], self._drawn.get(pair, _Drawn(())), None
        if self._probed is not None and self._probed[0] == pair:
            self._probed = None
        if quantity != HIDDEN:
            coloured = self._borders.coloured(pair, quantity, config, whole=view.whole_border)
        if before.node and (coloured is None or view.shell or before.body):
            before.node.remove()  # else the cloud is replaced
        if coloured is None:
            return _Drawn(wanted)
        most, size = (LIGHT_POINTS, LIGHT_SIZE) if view.light else (MAX_POINTS, POINT_SIZE)
        keep = subsample(len(coloured.points), most)
        legend = coloured.legend._replace(drawn=len(keep))
        if view.shell:
            heights = coloured.points[:, 2]
            faces = shell_faces(
                self._borders.surface(config), float(heights.min()), float(heights.max())
            )
            body = body_of(self._borders, faces, quantity, legend)
            return _Drawn(wanted, legend, self._send(pair, body), body)
        # One message for points and colours: no browser may see one without the other.
        node = self._scene.add_point_cloud(
            f"{ROOT}/border_{pair}",
            coloured.points[keep],
            coloured.colours[keep],
            point_size=size,
            point_shape="circle",
            precision="float32",
        )
        return _Drawn(wanted, legend, node)

    def _send(self, pair: str, body: trimesh.Trimesh) -> viser.GlbHandle:
        with io.BytesIO() as file:
            body.export(file, file_type="glb")
            data = file.getvalue()
        # Of the scene: one of the body's own would outline it, and keep the mouse from the arm.
        self._scene.remove_click_callback()
        self._scene.on_click()(self._click)
        return self._scene.add_glb(
            f"{ROOT}/shell_{pair}", data, cast_shadow=False, receive_shadow=False
        )

    def _click(self, event: viser.SceneClickEvent) -> None:
        self._clicked = np.array(event.ray_origin), np.array(event.ray_direction)

    def draw_probe(self, canvas: Canvas, snapshot: Snapshot, top: float) -> None:
        """Draw what was clicked: the place, its numbers, and which way the base would go."""
        if self._clicked is not None:
            found, self._clicked = self._look(snapshot, *self._clicked), None
            self._probed = found or self._probed
        if self._probed is None:
            return
        _, probe = self._probed
        base = self._model.description.base
        measure = measure_of(base.kind)
        forward, left, turn = planar(base.axes, probe.acceleration)
        way = f"{forward:+.2f} m/s²" + (f", {left:+.2f} m/s² left" if abs(left) > 0.005 else "")
        text = (
            f"det {probe.det:.3g}, R {probe.reach:.2f}, S {probe.score:.3g} {measure.unit}\n"
            f"base: {way}, {turn:+.2f} rad/s²"
        )
        canvas.point(f"{ROOT}/probe/p", probe.p, (255, 255, 255), 0.012)
        canvas.point(f"{ROOT}/probe/p_act", probe.p_act, ACTING, 0.012)
        canvas.lines(f"{ROOT}/probe/step", [np.array([probe.p, probe.p_act])], ACTING, 2.0)
        x, y, phi = snapshot.base_pose
        place = pin.utils.rotate("z", phi) @ probe.p + (x, y, 0.0)
        canvas.label("/probe/text", place, text.replace("-", "−"))
        draw_acceleration(canvas, f"{ROOT}/probe", probe.acceleration, base.axes, top)

    def _look(
        self, snapshot: Snapshot, origin: Array, direction: Array
    ) -> tuple[str, Probe] | None:
        """The pair whose body a ray from the world meets first, and the probe of that place."""
        x, y, phi = snapshot.base_pose
        R = pin.utils.rotate("z", -phi)  # from the world to the base
        origin, direction = R @ (origin - np.array([x, y, 0.0])), R @ direction
        bodies = [(pair, drawn.body) for pair, drawn in self._drawn.items() if drawn.body]
        hits = [(pair, first_hit(body, origin, direction)) for pair, body in bodies]
        met = [(float(np.linalg.norm(hit[0] - origin)), pair, hit) for pair, hit in hits if hit]
        if not met:
            return None
        _, pair, (p, n) = min(met, key=lambda each: each[0])
        return pair, probe_at(self._borders, pair, snapshot, p, n)


class BorderSlice:
    """A bright line around the base: the border at the height of p_b of the nearest pair of L_m."""

    def __init__(self, borders: Borders) -> None:
        self._borders = borders
        self._key: tuple[object, ...] = ()
        self._curves: list[Array] = []

    def draw(self, canvas: Canvas, snapshot: Snapshot, *, dark: bool) -> None:
        """Draw the slice, if there is one at that height; on a dark page or a light one."""
        mobile = [pair for pair in snapshot.pairs if pair.name in self._borders.pairs]
        if not mobile:
            return
        border = snapshot.border
        z = float(min(mobile, key=lambda pair: pair.d).p_b[2])
        key = (round(z / _GRAIN), border.d_b)
        if key != self._key:
            curves = self._borders.surface(border).curves(z)
            self._key = key
            self._curves = [np.concatenate([curve[:-1:_EVERY], curve[-1:]]) for curve in curves]
        if self._curves:
            canvas.lines(f"{ROOT}/slice", self._curves, _ON_DARK if dark else _ON_LIGHT, 2.5)


def shell_faces(surface: OffsetContours, low: float, high: float) -> tuple[Array, Array]:
    """(N, 3) [m] corners in the base's frame, and (M, 3) triangles, their fronts outwards.

    They are those of a border between two heights [m].
    """
    table, corners, faces = surface.table, [], []
    for first, end in zip(table.firsts[:-1], table.firsts[1:], strict=True):
        rows = np.unique([*range(first, end, _HEIGHTS), end - 1])
        rows = rows[(low <= table.heights[rows]) & (table.heights[rows] <= high)]
        at = table.vertices[rows, ::_RAYS]
        there = table.shown[rows, ::_RAYS] >= 0.0
        H, W = at.shape
        heights = np.repeat(table.heights[rows], W)
        index = sum(map(len, corners)) + np.arange(H * W).reshape(H, W)
        corners.append(np.column_stack([at.real.ravel(), at.imag.ravel(), heights]))
        quads = there[:-1, :-1] & there[1:, :-1] & there[:-1, 1:] & there[1:, 1:]
        a, b, c, d = (
            index[rows_, columns][quads]
            for rows_ in (slice(None, -1), slice(1, None))
            for columns in (slice(None, -1), slice(1, None))
        )
        faces += [np.column_stack([a, b, d]), np.column_stack([a, d, c])]
    return np.concatenate(corners), np.concatenate(faces)


def body_of(
    borders: Borders, shell: tuple[Array, Array], quantity: str, legend: Legend
) -> trimesh.Trimesh:
    """Corners and triangles with the colours of a legend, smooth and translucent."""
    corners, faces = shell
    values = borders.values(legend.pair, quantity, corners)
    u = np.clip(legend.normalised(values), 0.5 / _SHADES, 1.0 - 0.5 / _SHADES)
    shades = viridis(np.linspace(0.0, 1.0, _SHADES))[None]
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(np.repeat(shades, 2, axis=0)),
        baseColorFactor=[255, 255, 255, round(255 * _OPACITY)],
        alphaMode="BLEND",
        doubleSided=True,
        metallicFactor=0.0,
        roughnessFactor=1.0,
    )
    uv = np.column_stack([u, np.full(len(u), 0.5)])
    look = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(corners, faces, visual=look, process=False)


def first_hit(mesh: trimesh.Trimesh, origin: Array, direction: Array) -> tuple[Array, Array] | None:
    """(3,) [m] where a ray meets a mesh first, and (3,) the unit normal outwards there, or None."""
    a, b, c = np.moveaxis(np.asarray(mesh.triangles), 1, 0)
    ab, ac = b - a, c - a
    across = np.cross(direction, ac)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / np.einsum("ij,ij->i", ab, across)
        u = scale * np.einsum("ij,ij->i", origin - a, across)
        around = np.cross(origin - a, ab)
        v = scale * (around @ direction)
        way = scale * np.einsum("ij,ij->i", ac, around)
        hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (way > 0.0)
    if not hit.any():
        return None
    k = int(np.flatnonzero(hit)[way[hit].argmin()])
    n = np.cross(ab[k], ac[k])
    return origin + way[k] * direction, n / np.linalg.norm(n)


def probe_at(borders: Borders, pair: str, snapshot: Snapshot, p: Array, n: Array) -> Probe:
    """What holds at a place p of a pair's border, its normal n, (3,) each in the base's frame."""
    config, field = snapshot.config, borders.fields[pair]
    d_b, border = snapshot.d_b, snapshot.border
    d = _INSIDE * d_b
    p_b = p - (d_b - d) * n
    finder = ActingPointFinder(BorderSearch(borders.surface(border)), field)
    found = finder.find_acting_point(p_b, d, config.force)
    assert found is not None, "a border that is drawn has contours"
    f = avoidance_force(p_b, found.p_act, d, n, config.force.f_max, d_b)
    acceleration = field.base.A_b @ resultant_force(f[None], found.p_act[None])
    det, reach = field.singularity(p), field.reachability(p)
    return Probe(p, float(det), float(reach), float(field.score(p)), found.p_act, acceleration)
