"""Postures of a new robot: the ready posture, and the lines for guiding."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from itertools import islice, pairwise, product
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.config import parameter
from app.control.tasks import uncompensated_base_jacobian
from app.errors import UnreachableError
from app.jobs.progress import OnProgress, part_of
from app.onboarding.fit.convex import three
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import steps_of
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import (
    OUT_OF_REACH,
    PostureSearch,
    StartSolver,
    find_start,
    manipulability,
    point_text,
)
from app.strict import Array

RULE = (
    "chosen: the best of random postures within the middle 80 % of each joint's range, by "
    "distance beyond the buffer (up to 0.15 m), manipulability (relative to the best), an "
    "end-effector in front of or beside the base that points outwards or down, and joints near "
    "their middle"
)
_SAMPLES = 6000  # [-] number of random postures
_ENOUGH = 0.15  # [m] distance beyond the buffer above which more has no advantage


class Ready(NamedTuple):
    """A posture, and the monitored pair that is nearest in this posture."""

    q_m: Array  # (n_m,) [rad or m]
    beyond_buffer: float  # [m] distance of the pair beyond its buffer; inf without a pair
    nearest: str  # displayed name of the pair; empty without a pair


def find_ready(model: RobotModel, pairs: LinkPairs, *, seed: int) -> Ready:
    """The best of random postures by `RULE`, rounded to 0.01 rad or m."""
    search = _search(model, pairs)
    span = np.minimum(search.span, 2 * np.pi)  # no joint of the ready posture exceeds one turn
    random = np.random.default_rng(seed).random((_SAMPLES, model.n_m))
    postures = search.middle + (random - 0.5) * 0.8 * span

    def manipulability_of(q_m: Array) -> float:
        search.place(q_m)  # with fewer than 6 joints, only the position counts
        return manipulability(search.J_ee if model.n_m >= 6 else search.J_ee[:3])

    best = max(map(manipulability_of, postures)) or 1.0

    def worth(q_m: Array) -> float:
        return (
            1.5 * min(_ready(search, q_m).beyond_buffer, _ENOUGH) / _ENOUGH
            + manipulability_of(q_m) / best
            + _placed(search, model.p_base())
            - 0.5 * float(np.mean(np.abs(q_m - search.middle) / span))
        )

    return _ready(search, np.round(max(postures, key=worth), 2))


def judge_ready(model: RobotModel, pairs: LinkPairs, q_m: Array) -> Ready:
    """The posture q_m (n_m,), with the monitored pair that is nearest in it."""
    return _ready(_search(model, pairs), q_m)


def _search(model: RobotModel, pairs: LinkPairs) -> PostureSearch:
    return PostureSearch(model, pairs, model.description.config.border.d_b)


def _ready(search: PostureSearch, q_m: Array) -> Ready:
    search.place(q_m)
    d, name = min(zip(search.distances(), search.names, strict=True), default=(np.inf, ""))
    return Ready(q_m, float(d - search.d_b), name)


def _placed(search: PostureSearch, mount: Array) -> float:
    """[-] quality of a posture by its end-effector, ≤ 1.2; -10 near the floor or mount's axis."""
    at = search.state.T_world_ee
    out = at.translation - mount
    away = float(np.hypot(*out[:2]))
    if search.above_floor() < 0.1 or away < 0.05:
        return -10.0
    ahead = out[0] / away  # 1 in front, 0 beside, -1 behind
    points = at.rotation[:, 2]
    outwards = max(float(points[:2] @ out[:2]) / away, -float(points[2]))
    return 0.5 * max(ahead, 0.6 if ahead > -0.3 else ahead) + 0.7 * outwards


Point = tuple[float, float, float]
_Start = tuple[Array, Array]
"""(3,) [m] x, y and distance from the box around l_m of a start; (3,) unit vector to the base."""

INNER = 0.4  # [-] share of d_b below which the distance to a base at rest has to fall on a line
GIVES_WAY = 1 / 3  # [-] required displacement of the base in a run on a line, relative to d_b
CLEARANCE = 0.03  # [m] required distance between arm and base in a run on a line
_LOWEST = 0.01  # [m] required distance between the arm and the floor on a line
_MAX_RUNS = 3  # [-] largest number of tested lines
_MAX_STARTS = 40  # [-] limit of quick searches on near and on other lines; a failure takes ≤ 0.2 s
_MAX_COMPLETE = 8  # [-] largest number of complete searches of a start; a failure takes 0.3 to 2 s
_FARTHEST, _NEARER = 0.425, 0.025  # [m] largest distance of a start from the base, and its step
_OUTSIDE = 0.05  # [m] smallest distance of a start from the buffer
_LEFT_OVER = (0.125, 0.075, 0.025)  # [m] distances of the end of a line from a base at rest
_STEP = 0.0125  # [m] step along a line
_HEIGHTS = ((0.8, 0.0), (0.65, 0.0), (1.0, 0.0), (1.0, 0.1), (0.5, 0.0), (1.0, 0.2), (1.0, 0.35))
"""Heights of lines, the best ones first: a share [-] of a part's top, and an addition [m]."""
_SAME_TOP = 0.1  # [m] difference below which the tops of two parts count as equal
_NEAR = 0.15  # [m] largest distance of a position from the end-effector in a known posture
_FEW = 2  # [-] number of tries of a quick search


class Place(NamedTuple):
    """A line for guiding with its source."""

    start: Point  # [m] start in the frame of the base at the beginning
    move: Point  # [m] vector from the start to the end
    nearest: float  # [m] smallest distance between the arm and a base at rest on this line
    source: str  # source of the line for the description

    def content(self) -> dict[str, Any]:
        """The line in the form of a description."""
        source = {"start_m": self.source, "move_m": self.source}
        return {"start_m": self.start, "move_m": self.move, "source": source}


def find_place(
    model: RobotModel,
    pairs: LinkPairs,
    name: str,
    *,
    fault: Callable[[Place], str] = lambda _: "",
    anyway: bool = False,
    on_progress: OnProgress = lambda _: None,
) -> Place | str:
    """A line towards the side or the front of the base, or the reason why there is no line.

    A line is level. Its start is at most 0.425 m from l_m, its end at most 0.125 m. On it, without
    avoidance, the arm touches the base or comes nearer than `INNER` d_b. Lines to a contact are
    best, then those to the smallest distance; of equal lines, that on which the arm best
    compensates the base's motion, then the first one of `_front` or `_lateral`.

    `name` is the scenario, `guiding-front` or `guiding-lateral`. At least one of the monitored
    `pairs` has l_m. For `fault` and `anyway` see `chosen`. `on_progress` gets the finished share.
    """
    d_b = model.description.config.border.d_b
    guide = _Guide(model, pairs, d_b)
    if found := chosen(guide.lines(name, on_progress), d_b, fault, anyway=anyway):
        return found
    hundredths = range(round(100 * parameter("border.d_b").low), round(100 * d_b))
    smaller = [k / 100 for k in reversed(hundredths)]
    advice = [f"--buffer-distance {each:g} can give a line" for each in smaller]
    advice.append(
        "with these joint limits a smaller --buffer-distance probably does not help; a mount "
        "nearer to this side may help (--mount-xyz of an --arm-urdf)"
    )
    k = bisect_left(
        smaller, True, key=lambda d_b: bool(chosen(_Guide(model, pairs, d_b).lines(name), d_b))
    )
    return f"{guide.obstacles}; {advice[k]}"


def chosen(
    lines: Iterable[Place],
    d_b: float,
    fault: Callable[[Place], str] = lambda _: "",
    *,
    anyway: bool = False,
) -> Place | str:
    """The first line without a fault, of at most three lines that come nearer than `INNER` d_b [m].

    `fault` returns the fault of a line, or an empty string, as `fault_of_run` does. If each of the
    lines has a fault, the result is the first line if `anyway` is true, otherwise a text with the
    faults. If no line comes near enough, the result is an empty text.
    """
    tried: dict[Place, str] = {}
    for line in islice((each for each in lines if each.nearest < INNER * d_b), _MAX_RUNS):
        if not (why := fault(line)):
            return line
        tried[line] = why
    if tried and anyway:
        return next(iter(tried))
    return "; ".join(f"on the line from {point_text(line.start)}: {tried[line]}" for line in tried)


def fault_of_run(
    model: RobotModel,
    data: BorderData,
    name: str,
    place: Place,
    on_progress: OnProgress = lambda _: None,
) -> str:
    """The fault of a run of the scenario `name` on the line `place`, or an empty string.

    At the end, the base has to be at least `GIVES_WAY` times d_b from its start. Always, the arm
    has to be at least `CLEARANCE` from the base and 0.01 m from the floor. No bodies of the arm may
    overlap, and the default plant must report no contact. `on_progress` gets the finished share.
    """
    line = LINES[name].changed(start=place.start, move=place.move)
    run = RunSpec(model.description.name, line, model.description.config)
    pairs, search, moved, nearest = data.pairs, _search(model, data.pairs), 0.0, np.inf
    least = np.array([CLEARANCE if pair in pairs.mobile else 0.0 for pair in pairs.all])
    try:
        with closing(steps_of(run, model, data)) as steps:
            for number, (_, step) in enumerate(steps):
                if number % 100 == 0:
                    on_progress(step.t / line.duration)
                    search.place(step.truth.q_m)
                    if search.above_floor() < _LOWEST:
                        return f"the arm comes nearer than {_LOWEST:g} m to the floor"
                nearest = min(nearest, *step.distances[: len(pairs.mobile)])
                k = int(np.argmin(step.distances - least))
                if step.distances[k] < least[k]:  # the rest of the run cannot change that
                    near = f"comes nearer than {least[k]:g} m" if least[k] else "overlaps"
                    return f"{pairs.all[k].name} {near}"
                if any(step.contacts):
                    return "links touch each other or the floor"
                moved = float(np.hypot(*step.truth.base_pose[:2]))
    except UnreachableError as error:
        return str(error)
    if moved >= (needed := GIVES_WAY * search.d_b):
        return ""
    text = f"the base moves by {moved:.3f} m instead of {needed:.3f} m"
    return f"{text}; its smallest distance to the arm is {nearest:.3f} m"


def line_from(
    _: object,
    job: tuple[str, RobotModel, BorderData, bool],
    on_progress: OnProgress = lambda _: None,
) -> Place | str:
    """A line by `find_place`, tested by `fault_of_run`, or the reason why there is none.

    `job` has scenario, robot, border data, `anyway` of `find_place`. `on_progress` is as there.
    """
    name, model, data, anyway = job
    ends = np.linspace(0.0, 1.0, 2 + _MAX_RUNS)
    parts = (part_of(on_progress, begin, end) for begin, end in pairwise(ends.tolist()))
    return find_place(
        model,
        data.pairs,
        name,
        on_progress=next(parts),
        fault=lambda place: fault_of_run(model, data, name, place, next(parts)),
        anyway=anyway,
    )


class _Candidate(NamedTuple):
    """A possible line; the arm reaches its start with some orientation of the end-effector."""

    start: Point
    inwards: Array  # (3,) unit vector towards the base
    out: float  # [m] distance of its start from the side of the base
    left: float  # [m] distance of its end from the side of the base
    nearest: float  # [m] smallest distance between the arm and a base at rest
    carried: float
    """[-] mean share of the base's motion that the arm does not compensate, at the points of the
    line at which a pair with l_m is inside its buffer; 0 without such a point."""

    @property
    def move(self) -> Point:
        """[m] vector from its start to its end."""
        return three(np.round((self.out - self.left) * self.inwards, 3))

    @property
    def end(self) -> Array:
        return np.add(self.start, self.move)

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key: `nearest` (0 for a contact), `carried`; rounded to ignore small differences."""
        return round(max(self.nearest, 0.0), 3), round(self.carried, 1)


class _Guide:
    """Moves the end-effector kinematically along lines; the base rests at the origin."""

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        self.body = MobileBody(model)
        self._model, self._pairs, self._d_b = model, pairs, d_b
        self._search = PostureSearch(model, pairs, d_b)
        self._solver = StartSolver(model, pairs, d_b)
        self._mobile = len(pairs.mobile)
        found = []
        for q_m in self._search.guesses(np.random.default_rng(0), _SAMPLES):
            self._search.place(q_m)
            at = self._search.state.T_world_ee.translation.copy()
            found.append((q_m, at, self._search.flaw()))
        self._postures, self._places, self._flaws = map(np.array, zip(*found, strict=True))
        self._obstacles: Counter[str] = Counter()
        self._nearest: Place | None = None
        self._short = np.inf  # [m] smallest distance of a position in `_places` from a start

    @property
    def obstacles(self) -> str:
        """Why no line leads near the base: the best line, and the main reasons of failed starts."""
        by = {OUT_OF_REACH: f" by about {self._short:.2f} m"} if self._short > _NEAR else {}
        rows, of = self._obstacles.most_common(3), sum(self._obstacles.values())
        starts = ", ".join(f"{why}{by.get(why, '')} ({n} of {of} starts)" for why, n in rows)
        if (near := self._nearest) is None:
            return f"the arm can use none of the possible lines: {starts}"
        line = f"the line from {point_text(near.start)} leads to {near.nearest:.3f} m"
        text = f"no line brings the arm nearer to the base than {INNER * self._d_b:.3f} m; {line}"
        return f"{text}; the arm cannot use these starts: {starts}" if starts else text

    def lines(self, name: str, on_progress: OnProgress = lambda _: None) -> Iterator[Place]:
        """Lines of a scenario, the most promising ones first; no two have nearly the same end.

        First the arm follows each line from a known posture. A slower search then tests whether a
        run can start on the lines that lead nearer to the base than `INNER` times d_b: on each with
        few tries, later on the remaining ones with all tries. It pauses at each line that it
        yields. If it finds none, it yields one of the other lines on which a run can start.
        """
        mount = self._model.p_base()
        tops = _tops(self.body, float(mount[2]) + 0.4)  # not far above the arm
        heights = [round(share * top + over, 3) for share, over in _HEIGHTS for top in tops]
        last = [round(top + 0.025, 3) for top in tops]
        outs = np.arange(_FARTHEST, self._d_b + _OUTSIDE, -_NEARER).round(3).tolist()
        starts = list((_front if name == "guiding-front" else _lateral)(self.body, mount, outs))
        tried = [*product(starts, heights), *product(starts, last)]
        found: list[_Candidate] = []
        for k, (start, z) in enumerate(tried):
            on_progress(k / len(tried) / 2)
            if (line := self._look(start, z)) is not None:
                found.append(line)
        found.sort(key=attrgetter("rank"))  # stable order
        near = [line for line in found if line.nearest < INNER * self._d_b]
        first, rest = (each[:_MAX_STARTS] for each in (near, found[len(near) :]))
        steps = *product(first, [True]), *product(near, [False]), *product(rest, [True])
        done, complete = list[_Candidate](), 0
        for k, (line, quick) in enumerate(steps):
            if self._nearest and line.nearest >= INNER * self._d_b:
                return
            known = any(np.linalg.norm(line.end - other.end) < 0.1 for other in done)
            if known or (not quick and complete == _MAX_COMPLETE):
                continue
            on_progress((1 + k / len(steps)) / 2)
            complete += not quick
            p = line.start
            try:
                if quick:
                    self._solver.solve(p, tries=_FEW)
                done.append(line)
                q_m = find_start(self._model, self._pairs, self._d_b, p, seed=0, move=None)
            except UnreachableError as error:
                self._obstacles.update(why for why, _ in Counter(error.flaws).most_common(1))
                continue
            if (led := self._led(q_m, p, line.inwards, line.out, [line.left])) is None:
                continue
            source = (
                "chosen: of the lines with a start outside of the buffers, the line to contact on "
                "which the arm holds its end-effector best, or the line to the smallest distance "
                f"if none leads to contact; it ends {line.left:g} m beside the base; without "
                f"avoidance the smallest distance is {led.nearest:.3f} m"
            )
            place = Place(p, line.move, led.nearest, source)
            if self._nearest is None or place.nearest < self._nearest.nearest:
                self._nearest = place
            yield place

    def _look(self, start: _Start, z: float) -> _Candidate | None:
        """The line by `_led` from a start at height z [m]; None also if the arm cannot start."""
        at, inwards = start
        gap = _gap(self.body, np.array([*at[:2], z]) + at[2] * inwards, inwards)
        p = three([*np.round(at[:2] + gap * inwards[:2], 3), z])
        if (q_m := self._free_at(np.array(p))) is None:
            return None
        return self._led(q_m, p, inwards, at[2], [left for left in _LEFT_OVER if left < at[2]])

    def _led(
        self, q_m: Array, p: Point, inwards: Array, out: float, lefts: Sequence[float]
    ) -> _Candidate | None:
        """The line from p [m] to the first end in `lefts` with a contact, or to the last end. The
        arm follows it from the posture q_m (n_m,) without avoidance. None if the arm comes too near
        to the floor. The other arguments are fields of `_Candidate`.
        """
        search, model, least, carried, low = self._search, self._model, np.inf, [], np.inf
        speed, begin = model.description.config.ee_hold.min_speed, 0.0
        for left in lefts:
            end = out - left
            for led in np.minimum(np.arange(begin, end, _STEP) + _STEP, end):
                q_m = self._pulled(q_m, np.add(p, led * inwards))
                nearest = min(search.distances()[: self._mobile])
                least, low = min(least, nearest), min(low, search.above_floor())
                if nearest < self._d_b:
                    J_ee = search.state.J_ee
                    moved = J_ee[:3, : model.n_b] @ model.J_m_inv
                    lost = uncompensated_base_jacobian(J_ee, model.qd_max, model.J_m_inv, speed)
                    carried.append(float(np.linalg.norm(lost) / np.linalg.norm(moved)))
            if low < _LOWEST:
                why = f"the arm would be nearer than {_LOWEST:g} m to the floor on the line"
                self._obstacles[why] += 1
                return None
            begin = end
            if least <= 0.0:
                break
        share = float(np.mean(carried or [0.0]))
        return _Candidate(p, inwards, out, left, float(least), share)

    def _pulled(self, q_m: Array, p: Array) -> Array:
        """(n_m,) posture after a slow pull of the end-effector to p (3,) [m], which only the
        damping D of the joints resists: q̇ = D⁻¹ Jᵀ (J D⁻¹ Jᵀ)⁻¹ v.
        """
        search, D = self._search, np.array(self._search.model.description.arm.joint_damping)
        for _ in range(2):
            search.place(q_m)
            J = search.J_ee[:3]
            off, W = p - search.state.T_world_ee.translation, J / D
            # The small summand, in m/(N s), regularises singular postures.
            q_m = q_m + W.T @ np.linalg.solve(J @ W.T + 1e-9 * np.eye(3), off)
            q_m = np.clip(q_m, search.model.q_lower, search.model.q_upper)
        search.place(q_m)
        return q_m

    def _free_at(self, p: Array) -> Array | None:
        """(n_m,) a valid posture near a known one, with the end-effector at p (3,) [m]; or None."""
        away = np.linalg.norm(self._places - p, axis=1)
        self._short = min(self._short, float(away.min()))
        flaw = OUT_OF_REACH if away.min() > _NEAR else str(self._flaws[away.argmin()])
        away[self._flaws != ""] = np.inf
        for k in np.argsort(away)[: 6 if away.min() <= _NEAR else 0]:
            q_m = self._postures[k]
            for share in np.linspace(0.1, 1.0, 10):
                q_m = self._pulled(q_m, self._places[k] + share * (p - self._places[k]))
            off = np.linalg.norm(self._search.state.T_world_ee.translation - p)
            flaw = self._search.flaw() if off < 1e-3 else OUT_OF_REACH
            if not flaw:
                return q_m
        self._obstacles[flaw] += 1
        return None


def _tops(body: MobileBody, most: float) -> list[float]:
    """[m] tops of l_m's parts, at most `most`, in descending steps of more than `_SAME_TOP`."""
    found: list[float] = []
    for top in sorted((min(float(part.upper[2]), most) for part in body.parts), reverse=True):
        if not found or top < found[-1] - _SAME_TOP:
            found.append(top)
    return found


def _gap(body: MobileBody, p: Array, inwards: Array) -> float:
    """[m] distance from p (3,) [m] along `inwards` (3,) to l_m; 0 if the ray misses l_m."""
    steps = np.arange(0.0, float(np.abs(inwards) @ (body.upper - body.lower)), _STEP)
    met = body.distance(p + steps[:, None] * inwards) <= _STEP
    return float(steps[met.argmax()]) if met.any() else 0.0


def _lateral(body: MobileBody, mount: Array, outs: Sequence[float]) -> Iterator[_Start]:
    """Starts left and right of the base: at the mount's x, and near both ends of the base."""
    # A base without sideways motion hardly avoids a line to its axle.
    low, high = float(body.lower[0]) + 0.05, float(body.upper[0]) - 0.05
    sides = ((1.0, body.upper[1]), (-1.0, body.lower[1]))
    places = dict.fromkeys((float(np.clip(mount[0], low, high)), high, low))
    for x, out, (side, edge) in product(places, outs, sides):
        yield np.array([x, edge + side * out, out]), np.array([0.0, -side, 0.0])


def _front(body: MobileBody, mount: Array, outs: Sequence[float]) -> Iterator[_Start]:
    """Starts ahead of the base: left of the mount, near the base's edges, and at the mount's y."""
    low, high = float(body.lower[1]), float(body.upper[1])
    beside = float(np.clip(mount[1], low, high)) + 0.1
    for y, out in product((min(beside, high), low + 0.05, high - 0.05, float(mount[1])), outs):
        yield np.array([body.upper[0] + out, y, out]), np.array([-1.0, 0.0, 0.0])
