"""§4.3: the trade-off between the density of the border and the jumps of the acting point."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np

from app.avoidance.acting_point import ActingPointFinder
from app.border.cloud import Cloud
from app.border.dbb import Border, construct_dbb
from app.border.offset import OffsetContours
from app.border.points import BorderPoints
from app.border.score import ScoreField
from app.border.surface import BorderSurface, NearestBorder
from app.robot.link_pairs import Closest
from app.simulation.run import run_scenario
from app.simulation.session import DT
from app.studies.drawing import Drawing, Table
from app.studies.paper.experiments import Sources
from app.studies.paper.guiding import LATERAL, LATERAL_POINTS
from app.studies.paper.motion import closest_points
from app.studies.style import METHOD_COLOURS, level, new_figure, panel_title

Array = np.ndarray

PAPERS_COUNT = 50_000
"""[-] points of a border, by the paper's practical experience."""
NEEDS = (LATERAL,)
COUNTS = (5_000, 10_000, 20_000, 50_000)
"""Points of the thinned borders; the whole one is the last."""


class ScannedPoints(BorderPoints):
    """The border searched as printed: every point at the hand's height is looked at."""

    def __init__(self, border: Border, offset: OffsetContours) -> None:
        super().__init__(border, offset)
        self._border = border

    def _in_plan(self, p: Array) -> tuple[float, float] | None:
        points = self._border.same_height(float(p[2]))
        if not len(points):
            return None
        offsets = points[:, :2] - p[:2]
        x, y, _ = points[np.argmin(np.einsum("ij,ij->i", offsets, offsets))].tolist()
        return x, y


def figure_density(sources: Sources) -> Drawing:
    """Largest jump of the acting point and time per search, over the number of points."""
    table = trade_off(sources)
    figure = new_figure(3.6)
    jump, cost = figure.subplots(1, 2)
    for ax, column, label in (
        (jump, "jump_max_m", "largest jump in a control step [m]"),
        (cost, "find_p50_us", "median time of a search [µs]"),
    ):
        as_points = table["border"] == "points"
        ax.plot(
            table["points"][as_points],
            table[column][as_points],
            "o-",
            color=METHOD_COLOURS["points"],
            label="border of points, searched as printed",
        )
        surface, name = float(table[column][-1]), "as a continuous surface (used here)"
        if ax is jump:
            level(ax, surface, name)
        else:
            ax.axhline(surface, color="grey", linestyle=":", label=name)
            in_tree = table["border"] == "tree"
            ax.plot(
                table["points"][in_tree],
                table[column][in_tree],
                "o--",
                color=METHOD_COLOURS["points"],
                label="the same points in a tree of boxes",
            )
        ax.set_xscale("log")
        ax.set_ylim(0.0, None)
        ax.set(xlabel="points of the border [–]", ylabel=label)
        ticks = table["points"][as_points]
        ax.set_xticks(ticks, [f"{n / 1000:.0f}k" for n in ticks])
        ax.minorticks_off()
    panel_title(jump, "", "jumps of the acting point")
    panel_title(cost, "", "cost of the acting point")
    jump.legend(loc="upper right")
    cost.legend(loc="upper left")
    rows: dict[str, object] = {
        "surface" if kind == "surface" else f"{n} {kind}": _row(table, k)
        for k, (kind, n) in enumerate(zip(table["border"], table["points"].tolist(), strict=True))
    }
    return Drawing(
        "§4.3: density of the border",
        "The denser the border, the costlier the search and the smaller the jumps of the acting "
        "point; about 50,000 points suit a control rate of 1 kHz.",
        figure,
        {"": table},
        rows,
        ["The same hand path each time, that of the lateral guiding, at the control rate."],
    )


@lru_cache(maxsize=1)
def trade_off(sources: Sources) -> Table:
    """For each number of points, and for the surface: the jumps of p_act, the time of a search."""
    pair, config = sources.data.pairs.mobile[0], sources.config.border
    border = construct_dbb(sources.data.clouds[pair.name], config.d_b, config.eps)
    offset = OffsetContours(sources.model, config.d_b)
    field = ScoreField.of(sources.model, pair.b)
    path = hand_in_buffer(sources)
    counts = [n for n in COUNTS if n < len(border)] + [len(border)]
    borders = [thinned(border, count) for count in counts]
    shapes: list[NearestBorder] = [ScannedPoints(thin, offset) for thin in borders]
    shapes += [BorderPoints(thin, offset) for thin in borders]
    shapes.append(BorderSurface(border, offset))
    kinds = np.array(["points"] * len(counts) + ["tree"] * len(counts) + ["surface"])
    measured = [jump_and_cost(sources, ActingPointFinder(shape, field), path) for shape in shapes]
    jumps, typical, times = np.array(measured).T
    return Table(
        {
            "border": kinds,
            "points": np.array([*counts, *counts, len(border)]),
            "jump_max_m": jumps,
            "jump_p99_m": typical,
            "find_p50_us": times,
        }
    )


@lru_cache(maxsize=1)
def run_at_50_000(sources: Sources) -> dict[str, Any]:
    """Figures of the lateral guiding with 50,000 points a border, run alone: for its timing."""
    config = LATERAL_POINTS.config()
    border = config.border
    clouds = {}
    for name, cloud in sources.data.clouds.items():
        whole = len(construct_dbb(cloud, border.d_b, border.eps))
        clouds[name] = thinned_cloud(cloud, min(1.0, PAPERS_COUNT / whole))
    data = replace(sources.data, clouds=clouds)
    scenario = LATERAL_POINTS.full()
    return run_scenario(sources.model, data, scenario, config).figures


def thinned_cloud(cloud: Cloud, share: float) -> Cloud:
    """A share of a cloud's points, chosen at random, always the same."""
    count = round(share * len(cloud))
    chosen = np.sort(np.random.default_rng(0).choice(len(cloud), count, replace=False))
    return Cloud(cloud.pair, cloud.points[chosen], cloud.distances[chosen])


def hand_in_buffer(sources: Sources) -> list[Closest]:
    """The closest points of the hand while it is in its buffer, at each control step."""
    pair, run = sources.data.pairs.mobile[0], sources.runs[LATERAL]
    t = run.log["t_s"]
    fine = np.arange(t[0], t[-1], DT)
    q_m = np.column_stack([np.interp(fine, t, q) for q in run.q_m.T])
    path = closest_points(sources.model, pair, q_m)
    return [closest for closest in path if closest.d < sources.config.border.d_b]


def thinned(border: Border, count: int) -> Border:
    """A border of so many of its points, chosen at random, always the same."""
    chosen = np.sort(np.random.default_rng(0).choice(len(border), count, replace=False))
    return Border(
        border.pair, border.d_b, border.eps, border.points[chosen], border.heights[chosen]
    )


def jump_and_cost(
    sources: Sources, finder: ActingPointFinder, path: list[Closest]
) -> tuple[float, float, float]:
    """[m] largest and [m] 99th percentile of the jumps, [µs] median time of a search."""
    points, times = [], []
    for closest in path:
        begin = perf_counter()
        acting = finder.find_acting_point(closest.p_b, closest.d, sources.config.force)
        times.append(perf_counter() - begin)
        if acting is not None:
            points.append(acting.p_act)
    jumps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return float(jumps.max()), float(np.percentile(jumps, 99)), 1e6 * float(np.median(times))


def _row(table: Table, k: int) -> dict[str, object]:
    names = ("jump_max_m", "jump_p99_m", "find_p50_us")
    return {name: float(table[name][k]) for name in names}
