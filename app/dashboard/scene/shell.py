"""The border as a body: a translucent shell, and what a click on it tells of the place."""

from __future__ import annotations

import io
from typing import NamedTuple

import numpy as np
import trimesh
import viser
from PIL import Image
from trimesh.visual.material import PBRMaterial

from app.avoidance.mobile_acceleration import (
    ActingPointFinder,
    PairForce,
    avoidance_force,
    generate_mob_acc,
)
from app.border.surface import BorderSurface
from app.dashboard.scene.borders import Borders
from app.dashboard.scene.canvas import ROOT, Canvas
from app.dashboard.scene.colours import ACTING, viridis
from app.dashboard.scene.layers import draw_acceleration
from app.dashboard.scene.legend import Legend, measure_of, normalised
from app.dashboard.view import HIDDEN, View
from app.robot.bases.kind import planar
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

_RAYS = 3  # rays of a contour between two columns of the shell
_HEIGHTS = 2  # contours between two of its rows
_OPACITY = 0.42  # [-]
_SHADES = 256  # of the colours on it
_INSIDE = 0.5  # [-] of d_b: how near the base the arm is taken to be where it is clicked


class Probe(NamedTuple):
    """What holds at a place of the border, in the base's frame.

    Attributes:
        p: (3,) [m] the place.
        det, reach, score: Of (7), (9) and (10) there.
        p_act: (3,) [m] acting point of an arm that is halfway in there.
        acceleration: (n_b,) of the base for it, by (16).
    """

    p: Array
    det: float
    reach: float
    score: float
    p_act: Array
    acceleration: Array


class Shell:
    """Draws each coloured border as a body, and what the viewer has clicked on it."""

    def __init__(self, scene: viser.SceneApi, borders: Borders, model: RobotModel) -> None:
        """Nothing is drawn yet."""
        self._scene, self._borders, self._model = scene, borders, model
        self._drawn: dict[str, tuple[object, ...]] = {}
        self._bodies: dict[str, viser.GlbHandle] = {}
        self._meshes: dict[str, trimesh.Trimesh] = {}
        self._clicked: tuple[str, Array, Array] | None = None
        self._probed: tuple[str, Probe] | None = None

    def update(self, view: View, snapshot: Snapshot, legends: list[Legend]) -> None:
        """Send the bodies that have changed, with the colours of the legends."""
        border, shown = snapshot.config.border, {each.pair: each for each in legends}
        for pair, quantity in view.borders.items():
            legend = shown.get(pair)
            on = view.shell and quantity != HIDDEN and legend is not None
            wanted = (on, legend, view.whole_border)
            if self._drawn.get(pair) == wanted:
                continue
            self._drawn[pair] = wanted
            if self._probed is not None and self._probed[0] == pair:
                self._probed = None
            if pair in self._bodies:
                self._bodies.pop(pair).remove()
            if on and legend is not None:
                cloud = self._borders.coloured(pair, quantity, border, whole=view.whole_border)
                assert cloud is not None, "it has a legend"
                heights = float(cloud.points[:, 2].min()), float(cloud.points[:, 2].max())
                faces = shell_faces(self._borders.surface(pair, border), *heights)
                self._send(pair, coloured(self._borders, faces, quantity, legend))

    def draw(self, canvas: Canvas, snapshot: Snapshot, view: View, top: float) -> None:
        """Draw what was clicked: the place, its numbers, and which way the base would go."""
        if self._clicked is not None:
            pair, origin, direction = self._clicked
            self._clicked = None
            self._probed = self._look(pair, snapshot, origin, direction) or self._probed
        if self._probed is None or not view.shell:
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
        canvas.label(f"{ROOT}/probe/text", probe.p, text.replace("-", "−"), "bottom-left")
        draw_acceleration(canvas, f"{ROOT}/probe", probe.acceleration, base.axes, top)

    def _look(
        self, pair: str, snapshot: Snapshot, origin: Array, direction: Array
    ) -> tuple[str, Probe] | None:
        """The probe of the pair's body where a ray from the world meets it first."""
        mesh = self._meshes.get(pair)
        if mesh is None:
            return None
        x, y, phi = snapshot.base_pose
        c, s = np.cos(phi), np.sin(phi)
        R = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # from the world to the base
        hit = first_hit(mesh, R @ (origin - np.array([x, y, 0.0])), R @ direction)
        if hit is None:
            return None
        p, n = hit
        return pair, probe_at(self._borders, pair, snapshot, p, n)

    def _send(self, pair: str, mesh: trimesh.Trimesh) -> None:
        self._meshes[pair] = mesh
        with io.BytesIO() as file:
            mesh.export(file, file_type="glb")
            data = file.getvalue()
        node = f"{ROOT}/shell_{pair}"
        body = self._bodies[pair] = self._scene.add_glb(
            node, data, cast_shadow=False, receive_shadow=False
        )

        @body.on_click
        async def _(event: viser.SceneNodePointerEvent[viser.GlbHandle]) -> None:
            self._clicked = pair, np.array(event.ray_origin), np.array(event.ray_direction)


def shell_faces(surface: BorderSurface, low: float, high: float) -> tuple[Array, Array]:
    """(N, 3) [m] corners in the base's frame, and (M, 3) triangles, their fronts outwards.

    Args:
        surface: The border.
        low: [m] from which height on it is wanted.
        high: [m] up to which.
    """
    table, corners, faces = surface.table, [], []
    for first, end in zip(table.firsts[:-1], table.firsts[1:], strict=True):
        rows = np.unique([*range(first, end, _HEIGHTS), end - 1])
        rows = rows[(low <= table.heights[rows]) & (table.heights[rows] <= high)]
        at = table.vertices[rows, ::_RAYS]
        there = np.minimum(table.shown, table.reached)[rows, ::_RAYS] >= 0.0
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


def coloured(
    borders: Borders, shell: tuple[Array, Array], quantity: str, legend: Legend
) -> trimesh.Trimesh:
    """Corners and triangles with the colours of a legend, smooth and translucent."""
    corners, faces = shell
    values = borders.values(legend.pair, quantity, corners)
    u = np.clip(normalised(values, legend), 0.5 / _SHADES, 1.0 - 0.5 / _SHADES)
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
    d_b = config.border.d_b
    d = _INSIDE * d_b
    p_b = p - (d_b - d) * n
    finder = ActingPointFinder(borders.surface(pair, config.border), field)
    found = finder.find_acting_point(p_b, d, config.force)
    assert found is not None, "a border that is drawn has contours"
    f = avoidance_force(p_b, found.p_act, d, n, f_max=config.force.f_max, d_b=d_b)
    acceleration = generate_mob_acc([PairForce(f, found.p_act)], field.base)
    det, reach = field.singularity(p), field.reachability(p)
    return Probe(p, float(det), float(reach), float(field.score(p)), found.p_act, acceleration)
