"""The figure on continuity: a motion shrinks with the step, a jump does not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.robot.model import RobotModel
from app.studies.paper import density
from app.studies.paper.drawing import Drawing
from app.studies.paper.experiments import LATERAL, Sources
from app.studies.style import styled
from tests.reproduction import short_run, sources_of


@pytest.fixture(scope="module")
def sources(robot: RobotModel, border_data: BorderData) -> Sources:
    """The whole lateral guiding within 3 s; the end-effector ends in its buffer."""
    run = short_run(robot, border_data, LATERAL, 3.0)
    return sources_of(robot, border_data, {LATERAL: run})


@pytest.fixture(scope="module")
def drawn(sources: Sources) -> Drawing:
    with styled():
        return density.figure_continuity.draw(sources)


@pytest.mark.slow
def test_finer_path_shrinks_the_steps_on_the_surface_but_not_on_the_points(drawn) -> None:
    measured: dict[str, Any] = drawn.measured
    assert measured["surface"]["finer_ratio"] > 8.0
    assert measured["points"]["finer_ratio"] < 4.0
    assert min(measured["points_over_surface"].values()) > 20.0


def test_csv_contains_the_drawn_points_and_their_steps(drawn) -> None:
    table = drawn.tables[""]
    for kind in ("points", "surface"):
        mine = table["border"] == kind
        p_act = np.column_stack([table[f"p_act_{axis}_m"][mine] for axis in "xyz"])
        steps = np.linalg.norm(np.diff(p_act, axis=0), axis=1)
        np.testing.assert_allclose(table["p_act_step_m"][mine][1:], steps)
        assert steps.max() == pytest.approx(drawn.measured[kind]["step_max_m"])
    plan, change = drawn.figure.axes
    assert (plan.get_aspect(), change.get_yscale()) == (1.0, "log")


def test_the_path_is_the_logged_one_inside_the_buffer(sources: Sources) -> None:
    t, path = density.smooth_path_in_buffer(sources, 0.001)
    run = sources.runs[LATERAL]
    logged = np.interp(t, run.trace["t_s"], run.trace["d_lm-lEE_m"])
    np.testing.assert_allclose([closest.d for closest in path], logged, atol=1e-4)
    assert logged.max() <= sources.config.border.d_b + 1e-3
    np.testing.assert_allclose([np.linalg.norm(c.n) for c in path], 1.0)


def test_longest_stretch_in_the_buffer_is_drawn(sources: Sources) -> None:
    """The end-effector is in its buffer three times, and the second time is the longest."""
    run = sources.runs[LATERAL]
    d = run.trace["d_lm-lEE_m"]
    inside = np.zeros(len(d), bool)
    inside[5:10] = inside[20:90] = inside[-9:] = True
    log = run.trace.rows(slice(None))
    log["d_lm-lEE_m"][:] = np.where(inside, 0.1, 0.2)
    t, _ = density.smooth_path_in_buffer(
        replace(sources, runs={LATERAL: run._replace(trace=log)}), 0.001
    )
    np.testing.assert_allclose([t[0], t[-1]], [log.t[20], log.t[89]], atol=0.002)
