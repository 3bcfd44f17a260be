"""Borders: coloured points that move with the base, a slice, and values under the pointer."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import viser

from app.avoidance.acting_point import ActingPointFinder, avoidance_force, resultant_force
from app.border.dbb import Cloud, construct_dbb
from app.border.mobile import MobileBody
from app.border.nearest import OffsetContours, border_struct
from app.border.offset import offset_contours
from app.border.score import ScoreField
from app.config import BorderConfig
from app.dashboard import phrases as words
from app.dashboard.markup import minus
from app.dashboard.scene.canvas import ROOT, Canvas, Lens, in_world
from app.dashboard.scene.colours import ACTING, viridis
from app.dashboard.scene.layers import draw_acceleration
from app.dashboard.scene.legend import Legend, measure_of, title_of
from app.dashboard.view import HIDDEN, View
from app.robot.bases.kind import planar
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot
from app.strict import Array

MAX_POINTS = 20_000  # [-] of a drawn border; more points only hide the scene and cost time
LIGHT_POINTS = 4000  # [-] of a border on a page with low detail
POINT_SIZE = 0.0035  # [m] small, so that acting points stay visible
LIGHT_SIZE = 0.006  # [m] with `LIGHT_POINTS`
_EVERY = 3  # [-] every third point of a contour is drawn
_INSIDE = 0.5  # [-] assumed distance of the arm from the base for a `_Probe`, relative to d_b
_NEAR = 8.0  # [px] largest distance of a point from the pointer
_SMALL = 1e-4  # [m] step of a numerical gradient


class ColouredCloud(NamedTuple):
    points: Array  # (N, 3) [m] in the base's frame
    colours: Array  # (N, 3) uint8
    legend: Legend


class _Probe(NamedTuple):
    """A point of the border, and the base's response to an arm between this point and l_m."""

    p: Array  # (3,) [m] the point in the base's frame
    p_act: Array  # (3,) [m] acting point for the assumed arm, in the base's frame
    acceleration: Array  # (n_b,) [m/s² or rad/s²] acceleration (16) of the base
    text: str  # values of the point


class Borders:
    """Colours borders, with a cache that all viewers share."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud]) -> None:
        """Start with an empty cache; `clouds` has P_i of each pair of L_m, by the pair's name."""
        self.body = MobileBody(model)
        self.top = float(self.body.upper[2])  # [m] height of the base's top
        self._model, self._clouds = model, clouds
        # The name of a pair of L_m is `lm-<body of the arm>`.
        self.fields = {pair: ScoreField.of(model, pair.partition("-")[2]) for pair in clouds}
        # With a cache of functools, only the garbage collector could delete this object.
        self._kept: dict[tuple[object, ...], ColouredCloud | None] = {}

    def coloured(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool, light: bool = False
    ) -> ColouredCloud | None:
        """Return points of a pair's border, coloured by one of `QUANTITIES`; None without points.

        There are at most `MAX_POINTS`, or `LIGHT_POINTS` if `light`. Points above the base's top
        are omitted unless `whole`.
        """
        key = pair, quantity, border.d_b, border.eps, None if whole else self.top, light
        if key not in self._kept:
            if len(self._kept) >= 32:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = self._colour(*key)
        return self._kept[key]

    def surface(self, border: BorderConfig) -> OffsetContours:
        """Return the contours of the border, which are the same for all pairs."""
        return offset_contours(self._model, border.d_b)

    def _colour(
        self, pair: str, quantity: str, d_b: float, eps: float, top: float | None, light: bool
    ) -> ColouredCloud | None:
        points = construct_dbb(self._clouds[pair], d_b, eps).points
        if top is not None:
            points = points[points[:, 2] <= top]
        if not len(points):
            return None
        measure = "singularity" if quantity == "determinant" else quantity
        values = getattr(self.fields[pair], measure)(points)
        keep = subsample(len(points), MAX_POINTS)
        keep = keep[subsample(len(keep), LIGHT_POINTS)] if light else keep
        low, high = float(values.min()), float(values.max())
        u = (values[keep] - low) / (high - low) if high > low else np.full(len(keep), 0.5)
        title, unit = title_of(quantity, self._model.description.base.kind)
        name = words.spoken(pair, self._model.body_names)
        legend = Legend(name, title, unit, d_b, low, high, len(keep), len(points), top)
        return ColouredCloud(points[keep], viridis(u), legend)

    def probe(self, pair: str, p: Array, snapshot: Snapshot) -> _Probe:
        """Return the `_Probe` of the point p (3,) [m] of a pair's border, in the base's frame."""
        field, base, config = self.fields[pair], self._model.description.base, snapshot.config
        ends = self.body.distance(np.vstack([p + _SMALL * np.eye(3), p - _SMALL * np.eye(3)]))
        n = (ends[:3] - ends[3:]) / np.linalg.norm(ends[:3] - ends[3:])
        d_b, d = snapshot.d_b, _INSIDE * snapshot.d_b
        p_b = p - (d_b - d) * n
        finder = ActingPointFinder(border_struct(self.surface(snapshot.border)), field)
        found = finder.find_acting_point(p_b, d, config.force)
        assert found is not None, "a drawn border has contours"
        f = avoidance_force(p_b, found.p_act, d, n, config.force.f_max, d_b)
        acceleration = field.base.A_b @ resultant_force(f[None], found.p_act[None])
        way = words.acceleration(*planar(base.axes, acceleration))
        text = (
            f"score S {field.score(p):.3g} {measure_of(base.kind).unit}".strip() + ", "
            f"mobility {field.singularity(p):.3g}, reachability {field.reachability(p):.0f}\n"
            f"acceleration of the base by an arm here: {way}"
        )
        return _Probe(p, found.p_act, acceleration, text)


def subsample(total: int, most: int) -> Array:
    """Return at most `most` of `total` indices: always the same ones, without a visible pattern."""
    if total <= most:
        return np.arange(total)
    return np.random.default_rng(0).permutation(total)[:most]


class _Drawn(NamedTuple):
    cloud: ColouredCloud | None = None  # a pair's border; None if it is hidden or has no points
    node: viser.PointCloudHandle | None = None  # of `cloud` in the scene
    request: tuple[object, ...] = ()  # values on which the drawing depends


class DrawnBorders:
    """Draws the borders of a viewer, a slice, and values of the point under the pointer."""

    def __init__(self, scene: viser.SceneApi, borders: Borders, model: RobotModel) -> None:
        self._scene, self._borders, self._model = scene, borders, model
        self._drawn: dict[str, _Drawn] = {}
        self._probed: tuple[object, _Probe | None] = (), None
        self._slice: tuple[object, list[Array]] = (), []
        self.pointer: tuple[float, ...] = ()
        """[px] to the right and up from the scene's centre; empty if the pointer is elsewhere."""

    @property
    def legends(self) -> list[Legend]:
        return [drawn.cloud.legend for drawn in self._drawn.values() if drawn.cloud is not None]

    def update(self, view: View, border: BorderConfig) -> bool:
        """Draw changed borders; return whether there are any. Slow: call it outside of `atomic`."""
        changed = False
        for pair, quantity in view.borders.items():
            whole, light = view.whole_border, view.light
            request = (quantity, whole, light, border.d_b, border.eps)
            _, node, before = self._drawn.get(pair, _Drawn())
            if before == request:
                continue
            changed, cloud = True, None
            if quantity != HIDDEN:
                cloud = self._borders.coloured(pair, quantity, border, whole=whole, light=light)
            if cloud is not None:
                # One message has points and colours, so that they always match.
                node = self._scene.add_point_cloud(
                    f"{ROOT}/border_{pair}",
                    cloud.points,
                    cloud.colours,
                    point_size=LIGHT_SIZE if light else POINT_SIZE,
                    point_shape="circle",
                    precision="float32",
                )
            elif node is not None:
                node.remove()
                node = None
            self._drawn[pair] = _Drawn(cloud, node, request)
        return changed

    def draw_probe(self, canvas: Canvas, snapshot: Snapshot, lens: Lens | None) -> None:
        """Draw the probe at the border's point under the pointer, if there is one."""
        pointer = self.pointer  # the thread that receives messages can change it
        if not pointer or lens is None:
            return
        key = (pointer, *lens.eye, *snapshot.base_pose, snapshot.config)
        if key != self._probed[0]:
            self._probed = key, self._find(snapshot, lens, pointer)
        if (probe := self._probed[1]) is None:
            return
        canvas.point(f"{ROOT}/probe/p", probe.p, (255, 255, 255), 0.012)
        canvas.point(f"{ROOT}/probe/p_act", probe.p_act, ACTING, 0.012)
        canvas.lines(f"{ROOT}/probe/step", [np.array([probe.p, probe.p_act])], ACTING, 2.0)
        canvas.label("/probe/text", in_world(snapshot.base_pose, probe.p), minus(probe.text))
        axes, top = self._model.description.base.axes, self._borders.top
        draw_acceleration(canvas, f"{ROOT}/probe", probe.acceleration, axes, top)

    def draw_slice(self, canvas: Canvas, snapshot: Snapshot, *, dark: bool) -> None:
        """Draw the border's contour at the height of p_b of the L_m pair with the least d."""
        mobile = [pair for pair in snapshot.pairs if pair.name in self._borders.fields]
        if not mobile:
            return
        z = float(min(mobile, key=lambda pair: pair.d).p_b[2])
        key = (round(z / 0.002), snapshot.border.d_b)  # [m] resolution
        if key != self._slice[0]:
            curves = self._borders.surface(snapshot.border).curves(z)
            thin = [np.concatenate([curve[:-1:_EVERY], curve[-1:]]) for curve in curves]
            self._slice = key, thin
        colour = (255, 255, 255) if dark else (20, 24, 30)
        if self._slice[1]:
            canvas.lines(f"{ROOT}/slice", self._slice[1], colour, 2.5)

    def _find(self, snapshot: Snapshot, lens: Lens, pointer: tuple[float, ...]) -> _Probe | None:
        """Return the probe of the frontmost drawn point within `_NEAR` of the pointer, if any."""
        nearest, found = np.inf, None
        for pair, (cloud, _, _) in self._drawn.items():
            if cloud is None:
                continue
            u, v, depth = lens.pixel(in_world(snapshot.base_pose, cloud.points))
            off = np.hypot(u - pointer[0], v - pointer[1])
            depth[(depth <= 0.0) | (off > _NEAR)] = np.inf
            if depth.min() < nearest:
                nearest, found = depth.min(), (pair, cloud.points[depth.argmin()])
        return None if found is None else self._borders.probe(*found, snapshot)
