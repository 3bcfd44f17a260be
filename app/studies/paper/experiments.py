"""The runs of the paper's robot; several figures and claims can use one run."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from typing_extensions import Self

from app.avoidance.acting_point import ActingPoint, ActingPointFinder, avoidance_force
from app.border.cache import BorderData, load_border_data
from app.border.dbb import Border, construct_dbb
from app.border.nearest import OffsetContours, border_struct
from app.border.offset import offset_contours
from app.border.score import ScoreField
from app.config import Config, ForceConfig
from app.jobs.pool import Workers
from app.robot.description import load_robot
from app.robot.link_pairs import ClosestPoints, Pair, PairDistances
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import RunResult, run_from_spec
from app.simulation.scenarios import LINES, scenario_by_name
from app.simulation.scenarios.line import LineScenario, Point
from app.strict import Array
from app.studies.runs import thinned

ROBOT = "husky_panda"  # the paper's robot


class Experiment(RunSpec):
    """The specification of a run of the paper's robot."""

    @classmethod
    def of(cls, scenario: str, controller: str, **line: Point) -> Self:
        """The run of a scenario; `start` and `move` (3,) [m] replace those of a line."""
        return cls(ROBOT, scenario_by_name(scenario).changed(**line), Config(), controller)

    @property
    def name(self) -> str:
        """The run as a text, such as `tracking, dbb`."""
        scenario, start = self.scenario, ""
        if isinstance(scenario, LineScenario) and scenario.start != LINES[scenario.name].start:
            start = " from ({:g}, {:g}, {:g}) m".format(*scenario.start)
        border = ", border of points" if self.config.border.kind == "points" else ""
        return f"{scenario.name}{start}, {self.controller}{border}"

    def aim(self) -> Array:
        """(2, 3) [m] start and end of the end-effector's straight path, in the world."""
        scenario = self.scenario
        assert isinstance(scenario, LineScenario), f"{scenario.name} has no line"
        return np.array([scenario.start, np.add(scenario.start, scenario.move)])


TRACKING = Experiment.of("tracking", "dbb")
TRACKING_REPULSIVE = Experiment.of("tracking", "repulsive")
WHEEL_AXIS = Experiment.of("tracking", "dbb", start=(0.0, 0.68, 0.30))
"""An approach along the wheel axis. In this direction the base cannot move immediately."""
PAST_BASE = Experiment.of("tracking", "dbb", start=(0.08, 0.65, 0.5), move=(-0.08, -0.36, -0.02))
"""A path over the edge of the base: the base must not retreat farther than the arm can reach."""
WHEEL_AXIS_RIGHT = Experiment.of("tracking", "dbb", start=(0.0, -0.68, 0.30), move=(0.0, 0.2, 0.0))
LATERAL = Experiment.of("guiding-lateral", "dbb")
FRONT = Experiment.of("guiding-front", "dbb")
_GUIDING = {"lateral": LATERAL, "front": FRONT}
_POINTS = Config().replace("border.kind", "points")  # as in the paper
GUIDING = {
    "dbb": _GUIDING,
    "points": {name: each._replace(config=_POINTS) for name, each in _GUIDING.items()},
    "repulsive": {name: each._replace(controller="repulsive") for name, each in _GUIDING.items()},
}
"""The guiding runs, by the method and the direction; `points` is `dbb` on a border of points."""
COMPARED = tuple(each for by_direction in GUIDING.values() for each in by_direction.values())
"""The runs of Figure 15."""
AS_PRINTED = tuple(e._replace(controller="hqp") for e in (TRACKING, PAST_BASE, LATERAL, FRONT))
"""Runs of the paper's hierarchy."""
DOOR = Experiment.of("refrigerator", "dbb")
DOOR_NONE = Experiment.of("refrigerator", "none")
Runs = dict[Experiment, RunResult]
Named = dict[str, Experiment]


@dataclass(frozen=True, eq=False)
class Sources:
    """The data of figures and claims."""

    model: RobotModel
    data: BorderData
    config: Config  # the defaults, which all runs have except those on a border of points
    runs: Runs

    @property
    def pair(self) -> Pair:
        """The pair of base and end-effector, the first pair of L_m in (2)."""
        return self.data.pairs.mobile[0]

    @cached_property
    def border(self) -> Border:
        """DBB_1, the sampled border of the pair of base and end-effector."""
        return self.border_of(self.pair)

    @cached_property
    def field(self) -> ScoreField:
        """The score (10) of points on the border of the end-effector."""
        return ScoreField.of(self.model, self.pair.b)

    @cached_property
    def offset(self) -> OffsetContours:
        """The horizontal contours of the surface at the buffer distance from the base."""
        return offset_contours(self.model, self.config.border.d_b)

    def border_of(self, pair: Pair) -> Border:
        """DBB_i, the sampled border of a pair with the base."""
        config = self.config.border
        return construct_dbb(self.data.clouds[pair.name], config.d_b, config.eps)

    def finder(self, border: Border | None = None) -> ActingPointFinder:
        """Algorithm 3 for the end-effector on a border of points or, by default, on the surface."""
        points = [] if border is None else [border]
        return ActingPointFinder(border_struct(self.offset, points), self.field)

    def force(
        self, finder: ActingPointFinder, closest: ClosestPoints, force: ForceConfig | None = None
    ) -> tuple[ActingPoint, Array]:
        """Acting point, force (3,) [N] in the base's frame; `force` defaults to `config.force`."""
        force, p_b, d = force or self.config.force, closest.p_b, closest.d
        acting = finder.find_acting_point(p_b, d, force)
        assert acting is not None  # the paper's robot has a border at every height in the buffer
        d_b = self.config.border.d_b
        return acting, avoidance_force(p_b, acting.p_act, d, closest.n, force.f_max, d_b)

    def closest_points(self, q_m: Iterable[Array]) -> list[ClosestPoints]:
        """The closest points of base and end-effector, in the base's frame, at postures (n_m,)."""
        distances = PairDistances(self.model, [self.pair])
        found = []
        for q in q_m:
            distances.update(self.model.configuration((0.0, 0.0, 0.0), q))
            found.append(distances.closest(0))
        return found

    def distances(self, experiment: Experiment) -> Array:
        """(N,) [m] distance between base and end-effector in each row of an experiment."""
        return self.runs[experiment].trace[f"d_{self.pair.name}_m"]

    def results(self, named: Named, keys: Iterable[str]) -> dict[str, dict[str, Any]]:
        """The results with these keys of each experiment, by the names in `named`."""
        return {name: {key: self.runs[e].figures[key] for key in keys} for name, e in named.items()}

    def columns(self, named: Named, *columns: str) -> dict[str, dict[str, Array]]:
        """These columns of each experiment's trace, by the names in `named`."""
        return {name: {c: self.runs[e].trace[c] for c in columns} for name, e in named.items()}


def load_sources() -> Sources:
    """Load the paper's robot and its border, with the default parameters and without runs."""
    model = RobotModel(load_robot(ROBOT))
    return Sources(model, load_border_data(model), Config(), {})


def run_experiments(
    experiments: Iterable[Experiment],
    *,
    seed: int = 0,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Runs:
    """Run each experiment once with the same seed; the results have thinned traces.

    After each result, longest run first, `on_progress` gets the simulated time [s] so far.
    """
    # Longest first, so that all processes end at about the same time.
    todo = sorted(set(experiments), key=lambda e: (-e.scenario.duration, e.name))
    runs: Runs = {}
    with Workers(load_sources, min(processes, max(len(todo), 1))) as workers:
        for experiment, run in zip(todo, workers.map(partial(_run, seed), todo), strict=True):
            runs[experiment] = run
            on_progress(duration(runs))
    return runs


def duration(experiments: Iterable[Experiment]) -> float:
    """[s] total simulated time of some experiments, without repetition."""
    return sum(e.scenario.duration for e in set(experiments))


def _run(seed: int, sources: Sources, experiment: Experiment) -> RunResult:
    return thinned(run_from_spec(experiment._replace(seed=seed), sources.model, sources.data))
