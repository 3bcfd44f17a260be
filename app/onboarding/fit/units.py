"""Units: groups of links that move as one rigid body, and distances between their hulls."""

from collections.abc import Sequence
from itertools import product, starmap
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin
import trimesh

from app.onboarding import ROOT
from app.onboarding.fit.convex import directions, hull
from app.onboarding.read.links import Geometry
from app.onboarding.read.tree import PARALLEL, Arm
from app.robot.model import RobotModel, kept_per_model
from app.robot.shapes import convex_hull
from app.strict import Array

Pairs = Sequence[tuple[int, int]]
OfLinks = tuple[list[tuple[str, str]], Array]  # pairs of links; a column (N, pairs) for each

_THIN_OUT = 500  # [-] largest number of points on a unit's surface, without the outermost points
_MANY = 150  # [-] number of pairs of shapes from which bounding spheres save time


class Part(NamedTuple):
    """One hull of a unit."""

    link: str
    corners: Array  # (N, 3) [m] corners of the hull, in the joint's frame
    reach: Array  # (K,) [m] largest coordinates of the hull along `directions(2)`


class Unit(NamedTuple):
    """Links that move as one rigid body."""

    index: int
    """In `make_units`, 0 is the base, and 1 the links that are fixed to the base below the arm.
    Then each joint of the arm has one or two units: one beside the arm, if any, and the arm's."""
    frame: str
    """By `make_units`: the link that the joint moves, or the floor point; else the body's frame."""
    links: tuple[str, ...]
    joint: int  # number in pinocchio
    parts: tuple[Part, ...]
    surface: Array  # (N, 3) [m] points on the hulls, in the joint's frame
    owners: Array  # (N,) index of each point's link in `links`
    beside: bool = False  # whether another joint separates the unit from the arm's chain

    @property
    def name(self) -> str:
        """Name in messages: the link with the largest part; without parts the first link."""
        sizes = {part.link: float(np.ptp(part.corners, axis=0).prod()) for part in self.parts}
        return max(sizes, key=sizes.__getitem__, default=self.links[0])


def make_units(model: RobotModel, arm: Arm, geometry: Geometry) -> tuple[Unit, ...]:
    """The units in the order of `Unit.index`."""
    wanted = [(ROOT, arm.base_links, 1, False), (ROOT, arm.segments[0], 1, False)]
    rows = zip(arm.joints, arm.segments[1:], arm.beside[1:], strict=True)
    for k, (joint, links, beside) in enumerate(rows, 2):
        if any(geometry[link].shapes for link in beside):
            wanted.append((joint.child, beside, k, True))
            links = tuple(link for link in links if link not in beside)
        wanted.append((joint.child, links, k, False))
    return tuple(_unit(model, geometry, k, *each) for k, each in enumerate(wanted))


def units_of_links(model: RobotModel, geometry: Geometry) -> dict[str, list[Unit]]:
    """The units of each body of a description, by the body's name. A body has one unit for each
    joint that moves some of its links. The units are numbered consecutively.
    """
    covered = [(body, link) for body in model.description.bodies for link in body.covers]
    joint = {k: model.pin.frames[model.pin.getFrameId(k)].parentJoint for _, k in covered}
    last = {joint[link]: body.name for body, link in covered}  # earlier bodies are beside the chain
    found: dict[str, list[Unit]] = {body.name: [] for body in model.description.bodies}
    groups = dict.fromkeys((body.name, body.frame, joint[link]) for body, link in covered)
    for index, (name, frame, k) in enumerate(groups):
        links = tuple(link for body, link in covered if body.name == name and joint[link] == k)
        beside = k > 1 and last[k] != name
        found[name].append(_unit(model, geometry, index, frame, links, k, beside))
    return found


def _unit(
    model: RobotModel,
    geometry: Geometry,
    index: int,
    frame: str,
    links: tuple[str, ...],
    joint: int,
    beside: bool,
) -> Unit:
    parts, surface, owners = [], [np.zeros((0, 3))], [np.zeros(0, dtype=int)]
    D = directions(2)
    for k, link in enumerate(links):
        T = model.pin.frames[model.pin.getFrameId(link)].placement
        for shape in geometry[link].shapes:
            corners = hull(moved(np.asarray(shape.hull.vertices), T)).corners
            parts.append(Part(link, corners, (corners @ D.T).max(axis=0)))
        surface.append(moved(geometry[link].surface, T))
        owners.append(np.full(len(surface[-1]), k))
    points, owner = np.vstack(surface), np.concatenate(owners)
    if len(points) > _THIN_OUT:  # the outermost points stay: a body has to enclose fingertips
        some = np.random.default_rng(0).permutation(len(points))[:_THIN_OUT]
        kept = np.union1d(some, (points @ D.T).argmax(axis=0))
        points, owner = points[kept], owner[kept]
    return Unit(index, frame, links, joint, tuple(parts), points, owner, beside)


def moved(points: Array, T: pin.SE3) -> Array:
    """The points (N, 3) [m] of frame B in coordinates of frame A, (N, 3) [m]; T is T_A_B."""
    return points @ T.rotation.T + T.translation


def placements(model: RobotModel, q_m: Array) -> list[pin.SE3]:
    """The poses of the joint frames in a posture q_m (n_m,), with the base at the origin."""
    data = model.pin.createData()
    pin.forwardKinematics(model.pin, data, model.configuration((0.0, 0.0, 0.0), q_m))
    return [T.copy() for T in data.oMi]


def neighbours(model: RobotModel, a: Unit, b: Unit) -> bool:
    """Whether contacts of two units are allowed by design: units on the same joint, units that only
    parallel prismatic joints separate, and units that one joint separates if neither is `beside`.
    """
    first, last = sorted((a.joint, b.joint))
    if last == first or (last - first == 1 and not (a.beside or b.beside)):
        return True
    data = model.pin.createData()
    pin.computeJointJacobians(model.pin, data, pin.neutral(model.pin))
    joints = model.pin.joints[first + 1 : last + 1]
    columns = data.J[:, [joint.idx_v for joint in joints]]
    parallel = np.abs(columns[:3].T @ columns[:3, 0]) > PARALLEL
    return not columns[3:].any() and bool(parallel.all())


Placed = tuple[int, pin.SE3, coal.CollisionGeometry]
"""A shape: its joint's number in pinocchio, its pose in the joint's frame, its geometry."""
Groups = Sequence[Sequence[Placed]]


def shape_distances(
    model: RobotModel, groups: Groups, pairs: Pairs, q_m: Array, exact: float = 0.5
) -> Array:
    """(N, pairs) [m] signed distances between groups of shapes: the smallest over their shapes.

    `pairs` are pairs of groups by their indices; q_m (N, n_m) are the joint positions. With 150 or
    more pairs of shapes, only distances below `exact` [m] are exact; others give at least `exact`.
    """
    geometry, ids = pin.GeometryModel(), []
    for group in groups:
        first = geometry.ngeoms
        for k, (joint, T, shape) in enumerate(group, first):
            geometry.addGeometryObject(pin.GeometryObject(f"shape_{k}", joint, 0, T, shape))
        ids.append(range(first, geometry.ngeoms))
    shapes = [(k, *ij) for k, (a, b) in enumerate(pairs) for ij in product(ids[a], ids[b])]
    for _, i, j in shapes:
        geometry.addCollisionPair(pin.CollisionPair(i, j))
    found = np.empty((len(q_m), len(pairs)))
    if not shapes:
        return found
    placed, data = pin.GeometryData(geometry), model.pin.createData()
    results = [*placed.distanceResults]
    spheres = []  # bounding spheres: joint, centre in its frame, radius
    for shape in geometry.geometryObjects:
        shape.geometry.computeLocalAABB()
        centre = shape.placement.act(shape.geometry.aabb_center)
        spheres.append((shape.parentJoint, centre, shape.geometry.aabb_radius))
    joints, centres, radii = map(np.array, zip(*spheres, strict=True))
    own, first, second = np.array(shapes).T  # number of the pair, numbers of both shapes
    starts = np.flatnonzero(np.diff(own, prepend=-1))
    for row, posture in zip(found, q_m, strict=True):
        q = model.configuration((0.0, 0.0, 0.0), posture)
        pin.updateGeometryPlacements(model.pin, data, geometry, placed, q)
        if len(shapes) < _MANY:
            pin.computeDistances(geometry, placed)
            row[:] = np.minimum.reduceat([r.min_distance for r in results], starts)
            continue
        T = np.array([each.homogeneous for each in data.oMi])[joints]
        at = np.einsum("nij,nj->ni", T[:, :3, :3], centres) + T[:, :3, 3]
        least = np.linalg.norm(at[first] - at[second], axis=1) - radii[first] - radii[second]
        row[:] = np.minimum.reduceat(least, starts)
        near, known = row < exact, np.full(len(shapes), np.inf)
        limit = np.where(near, row, -np.inf)
        for _ in range(2):  # first the two shapes with the smallest bound, then all that are nearer
            for k in np.flatnonzero(least <= limit[own]).tolist():
                known[k], least[k] = pin.computeDistance(geometry, placed, k).min_distance, np.inf
            limit = np.minimum(np.minimum.reduceat(known, starts), exact)
        row[near] = np.minimum.reduceat(known, starts)[near]
    return found


def meshes_meet(model: RobotModel, a: Unit, b: Unit, geometry: Geometry, q_m: Array) -> OfLinks:
    """Pairs (link of a, link of b) with shapes; (N, pairs) whether these touch at q_m (N, n_m)."""
    data, request, here = model.pin.createData(), coal.CollisionRequest(), coal.Transform3s()
    first, second = ([k for k in unit.links if geometry[k].shapes] for unit in (a, b))
    meshes = {k: [_triangles(s.mesh) for s in geometry[k].shapes] for k in (*first, *second)}
    frames, pairs = {k: model.pin.getFrameId(k) for k in meshes}, [*product(first, second)]

    def touch(one: str, two: str) -> bool:
        T = data.oMf[frames[one]].actInv(data.oMf[frames[two]])
        at, both = coal.Transform3s(T.rotation, T.translation), product(meshes[one], meshes[two])
        return any(coal.collide(x, here, y, at, request, coal.CollisionResult()) for x, y in both)

    found = np.zeros((len(q_m), len(pairs)), dtype=bool)
    for row, posture in zip(found, q_m, strict=True):
        q = model.configuration((0.0, 0.0, 0.0), posture)
        pin.framesForwardKinematics(model.pin, data, q)
        row[:] = [*starmap(touch, pairs)]
    return pairs, found


def _triangles(mesh: trimesh.Trimesh) -> coal.BVHModelOBBRSS:
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(mesh.faces), len(mesh.vertices))
    made.addVertices(np.asarray(mesh.vertices, dtype=float))
    made.addTriangles(np.asarray(mesh.faces, dtype=np.int64))
    made.endModel()
    return made


def link_shapes(model: RobotModel, units: Sequence[Unit]) -> dict[str, list[Placed]]:
    """The hulls of each link that has a shape, by the name of the link."""
    shapes: dict[str, list[Placed]] = {}
    for unit in units:
        for part, placed in zip(unit.parts, hulls(model, unit), strict=True):
            shapes.setdefault(part.link, []).append(placed)
    return shapes


def hulls(model: RobotModel, unit: Unit) -> list[Placed]:
    """The hulls of a unit's parts."""
    return [(unit.joint, pin.SE3.Identity(), _coal_hull(model, k.corners)) for k in unit.parts]


@kept_per_model(512)  # an RBY1 has 48 parts; a hull of 2,000 corners takes 1.5 MB
def _coal_hull(_: RobotModel, points: Array) -> coal.CollisionGeometry:
    return convex_hull(points)


def hull_distances(model: RobotModel, units: Sequence[Unit], pairs: Pairs, q_m: Array) -> Array:
    """(N, pairs) [m] signed distances between the hulls of units in the postures q_m (N, n_m)."""
    return shape_distances(model, [hulls(model, unit) for unit in units], pairs, q_m)


def link_gaps(model: RobotModel, u: Unit, v: Unit, q_m: Array) -> OfLinks:
    """Pairs (link of u, link of v), and their distances (N, pairs) [m] in postures q_m (N, n_m)."""
    pairs = [*product(link_shapes(model, [u]), link_shapes(model, [v]))]
    return pairs, link_distances(model, link_shapes(model, [u, v]), pairs, q_m)


def link_distances(
    model: RobotModel, shapes: dict[str, list[Placed]], pairs: Sequence[tuple[str, str]], q_m: Array
) -> Array:
    """(N, pairs) [m] signed distances of links at q_m (N, n_m); `shapes` has the links' hulls."""
    number = list(shapes).index
    numbers = [(number(a), number(b)) for a, b in pairs]
    return shape_distances(model, list(shapes.values()), numbers, q_m)
