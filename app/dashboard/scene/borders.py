"""Borders: coloured points or surfaces that move with the base, and their slice at the arm."""

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
"""[-] drawn points of a border; more points only hide the scene and slow down the browser."""
LIGHT_POINTS = 4000  # [-] the same on a page without a GPU
_KEPT = 32  # [-] cached clouds
POINT_SIZE = 0.0035  # [m] small, so that acting points stay visible
LIGHT_SIZE = 0.006  # [m] with `LIGHT_POINTS`
_GRAIN = 0.002  # [m] resolution of the slice's height
_EVERY = 3  # rays of the contour between two drawn points
_ON_DARK: Rgb = (255, 255, 255)
_ON_LIGHT: Rgb = (20, 24, 30)
_RAYS = 3  # rays of a contour per column of the surface
_HEIGHTS = 2  # contours per row of the surface
_OPACITY = 0.42  # [-]
_SHADES = 256  # colours of the surface
_INSIDE = 0.5  # [-] assumed distance of the arm at a click, relative to d_b


class ColouredCloud(NamedTuple):
    """A border for a browser: points (N, 3) [m] in the base's frame, and colours (N, 3) uint8."""

    points: Array
    colours: Array
    legend: Legend


class Borders:
    """Selects and colours borders of the stored clouds, with a cache that all viewers share."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud]) -> None:
        """Start with an empty cache; `clouds` has P_i of each pair of L_m, by the pair's name."""
        self.pairs = frozenset(clouds)
        """Names of the pairs of L_m."""
        self.top = float(MobileBody(model).upper[2])
        """[m] height of the base's top; the border above it is drawn on demand only."""
        self._model, self._clouds = model, clouds
        # The name of a pair of L_m is `lm-<body of the arm>`.
        self.fields = {pair: ScoreField.of(model, pair.partition("-")[2]) for pair in clouds}
        """Scores by the pair's name."""
        self._kept: dict[tuple[object, ...], Any] = {}

    def coloured(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        """Return a border's points, coloured by a quantity; None if the border has no points.

        Args:
            pair: Name of the pair.
            quantity: One of `app.dashboard.scene.legend.QUANTITIES`.
            border: Parameters of the border.
            whole: Whether to include points above the base's top.
        """
        return self._keep(
            (pair, quantity, border.d_b, border.eps, whole),
            lambda: self._colour(pair, quantity, border, whole=whole),
        )

    def surface(self, border: BorderConfig) -> OffsetContours:
        """Return the contours of the border, which are the same for all pairs."""
        return offset_contours(self._model, border.d_b)

    def values(self, pair: str, quantity: str, points: Array) -> Array:
        """Return a quantity of `QUANTITIES` (N,) at points (N, 3) [m] in the base's frame."""
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
    """Return `most` of `total` indices at most, always the same ones, without a visible pattern."""
    if total <= most:
        return np.arange(total)
    return np.random.default_rng(0).permutation(total)[:most]


class Probe(NamedTuple):
    """Quantities at a point of the border, in the base's frame."""

    p: Array
    """(3,) [m] the point."""
    det: float
    reach: float
    score: float
    """Determinant (7), reachability (9) and score (10) at the point."""
    p_act: Array
    """(3,) [m] acting point of an arm that is halfway inside the buffer there."""
    acceleration: Array
    """(n_b,) acceleration of the base by this arm, (16)."""


class _Drawn(NamedTuple):
    """Drawn parts of a pair's border; empty if the border is hidden or has no points."""

    request: tuple[object, ...]
    legend: Legend | None = None
    node: viser.PointCloudHandle | viser.GlbHandle | None = None
    body: trimesh.Trimesh | None = None


class DrawnBorders:
    """Draws the border of each pair again when its quantity, d_b, ε or style has changed.

    A border is a cloud of points or a translucent surface. A click on the surface shows the
    quantities there.
    """

    def __init__(self, scene: viser.SceneApi, borders: Borders, model: RobotModel) -> None:
        self._scene, self._borders, self._model = scene, borders, model
        self._drawn: dict[str, _Drawn] = {}
        self._clicked: tuple[Array, Array] | None = None
        self._probed: tuple[str, Probe] | None = None

    @property
    def legends(self) -> list[Legend]:
        """Legends of the drawn borders."""
        return [drawn.legend for drawn in self._drawn.values() if drawn.legend is not None]

    def update(self, view: View, border: BorderConfig) -> bool:
        """Draw all borders that have changed.

        Returns:
            Whether a border has changed; then `legends` is new.
        """
        changed = False
        for pair, quantity in view.borders.items():
            request = (quantity, view.whole_border, view.light, view.shell, border.d_b, border.eps)
            if pair not in self._drawn or self._drawn[pair].request != request:
                self._drawn[pair] = self._draw(pair, request, view, border)
                changed = True
        return changed

    def _draw(
        self, pair: str, request: tuple[object, ...], view: View, config: BorderConfig
    ) -> _Drawn:
        quantity, before, coloured = view.borders[pair], self._drawn.get(pair, _Drawn(())), None
        if self._probed is not None and self._probed[0] == pair:
            self._probed = None
        if quantity != HIDDEN:
            coloured = self._borders.coloured(pair, quantity, config, whole=view.whole_border)
        if before.node and (coloured is None or view.shell or before.body):
            before.node.remove()  # without this case, the new cloud replaces the old one
        if coloured is None:
            return _Drawn(request)
        most, size = (LIGHT_POINTS, LIGHT_SIZE) if view.light else (MAX_POINTS, POINT_SIZE)
        keep = subsample(len(coloured.points), most)
        legend = coloured.legend._replace(drawn=len(keep))
        if view.shell:
            heights = coloured.points[:, 2]
            faces = shell_faces(
                self._borders.surface(config), float(heights.min()), float(heights.max())
            )
            body = body_of(self._borders, faces, quantity, legend)
            return _Drawn(request, legend, self._send(pair, body), body)
        # One message has points and colours, so that they always match.
        node = self._scene.add_point_cloud(
            f"{ROOT}/border_{pair}",
            coloured.points[keep],
            coloured.colours[keep],
            point_size=size,
            point_shape="circle",
            precision="float32",
        )
        return _Drawn(request, legend, node)

    def _send(self, pair: str, body: trimesh.Trimesh) -> viser.GlbHandle:
        with io.BytesIO() as file:
            body.export(file, file_type="glb")
            data = file.getvalue()
        # A click callback of the surface itself would outline it and block the mouse for the arm.
        self._scene.remove_click_callback()
        self._scene.on_click()(self._click)
        return self._scene.add_glb(
            f"{ROOT}/shell_{pair}", data, cast_shadow=False, receive_shadow=False
        )

    def _click(self, event: viser.SceneClickEvent) -> None:
        self._clicked = np.array(event.ray_origin), np.array(event.ray_direction)

    def draw_probe(self, canvas: Canvas, snapshot: Snapshot, top: float) -> None:
        """Draw the clicked point with its quantities and the acceleration of the base."""
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
        """Return the pair whose surface a ray in the world hits first, and the probe there."""
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
        """Draw the slice, if the border has one at this height, for a dark or a light page."""
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
    """Return the surface of a border between two heights [m].

    Returns:
        Corners (N, 3) [m] in the base's frame, and triangles (M, 3) with outward front sides.
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
    """Return a surface as a smooth and translucent mesh in the colours of a legend."""
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
    """Return the first hit (3,) [m] of a ray on a mesh and the outward normal (3,), or None."""
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
    """Return the quantities at point p of a pair's border with normal n, in the base's frame."""
    config, field = snapshot.config, borders.fields[pair]
    d_b, border = snapshot.d_b, snapshot.border
    d = _INSIDE * d_b
    p_b = p - (d_b - d) * n
    finder = ActingPointFinder(BorderSearch(borders.surface(border)), field)
    found = finder.find_acting_point(p_b, d, config.force)
    assert found is not None, "a drawn border has contours"
    f = avoidance_force(p_b, found.p_act, d, n, config.force.f_max, d_b)
    acceleration = field.base.A_b @ resultant_force(f[None], found.p_act[None])
    det, reach = field.singularity(p), field.reachability(p)
    return Probe(p, float(det), float(reach), float(field.score(p)), found.p_act, acceleration)
