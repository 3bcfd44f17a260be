"""Each figure draws the data of its CSV, from runs and from the project's own functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.control.tasks import activation
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.run import RunResult
from app.studies.paper import approach, density, departures, method
from app.studies.paper.drawing import Drawing
from app.studies.paper.experiments import (
    AS_PRINTED,
    COMPARED,
    DOOR,
    DOOR_NONE,
    LATERAL,
    PAST_BASE,
    TRACKING,
    TRACKING_REPULSIVE,
    WHEEL_AXIS,
    Sources,
)
from app.studies.paper.report import FIGURES
from app.studies.style import METHOD_COLOURS, styled
from tests.reproduction import every, short_run, sources_of


@pytest.fixture(scope="module")
def sources(robot: RobotModel, border_data: BorderData) -> Sources:
    """Two seconds of guiding into the buffer, used for every experiment on a line."""
    run = short_run(robot, border_data, LATERAL, 2.0)
    tracking = [TRACKING, TRACKING_REPULSIVE, WHEEL_AXIS, PAST_BASE]
    return sources_of(robot, border_data, every([*tracking, *COMPARED, *AS_PRINTED], run))


@pytest.fixture(scope="module")
def drawn(sources: Sources) -> dict[str, Drawing]:
    names = ("fig3", "fig5", "fig6", "fig7", "fig8", "fig10", "fig12", "fig14", "fig15")
    with styled(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(method.maps, "FINE_SAMPLES", 6000)  # of Figure 6
        return {name: FIGURES[name].draw(sources) for name in names}


def lines(drawing: Drawing) -> list[tuple[Axes, np.ndarray, np.ndarray]]:
    """All lines of more than two points in a figure."""
    found = [(ax, *line.get_data()) for ax in drawing.figure.axes for line in ax.get_lines()]
    return [(ax, np.asarray(x), np.asarray(y)) for ax, x, y in found if len(x) > 2]


def contains(table: Any, values: np.ndarray) -> bool:
    """Whether a column of the table contains the values in sequence."""
    columns = [c for c in table.values() if c.dtype.kind == "f"]
    n = len(values)
    return any(
        any(
            np.array_equal(column[k : k + n], values, equal_nan=True)
            for k in range(0, len(column) - n + 1, max(1, n))
        )
        for column in columns
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", ["fig10", "fig12", "fig14", "fig15"])
def test_every_line_is_in_the_csv(drawn, name):
    drawing = drawn[name]
    assert lines(drawing)
    for ax, x, y in lines(drawing):
        assert contains(drawing.tables[""], x)
        if ax.get_yscale() == "linear":
            assert contains(drawing.tables[""], y)


def test_figures_have_a_number_labelled_axes_and_units(drawn):
    for name, drawing in drawn.items():
        number = name.removeprefix("fig")
        assert FIGURES[name].title.startswith(f"Figure {number}:")
        assert len(FIGURES[name].caption) > 40
        # Panels that share an axis are labelled once.
        for labels in (
            [ax.get_xlabel() for ax in drawing.figure.axes],
            [ax.get_ylabel() for ax in drawing.figure.axes],
        ):
            assert any(labels), name
            assert all("[" in text for text in labels if text), (name, labels)


def test_no_two_panels_of_a_figure_have_the_same_letter(drawn):
    for name, drawing in drawn.items():
        axes = drawing.figure.axes  # those in three dimensions have their title in the middle
        titles = [ax.get_title("center" if ax.name == "3d" else "left") for ax in axes]
        letters = [title.split(")")[0] for title in titles if title.startswith("(")]
        assert len(letters) == len(set(letters)), (name, letters)
        assert letters or name == "fig10", name


def test_columns_of_quantities_end_in_their_unit(drawn):
    plain = (
        "set",
        "direction",
        "controller",
        "point",
        "step",
        "beta",
        "reachability",
        "fit",
        "paper",
    )
    units = ("_m", "_s", "_rad", "_mps2", "_radps2", "_m4prad4", "_us")
    for drawing in drawn.values():
        for table in drawing.tables.values():
            odd = [c for c in table if not c.startswith(plain) and not c.endswith(units)]
            assert odd == []


def test_one_method_has_one_colour_in_all_figures(drawn):
    for name in ("fig12", "fig15"):
        colours = {line.get_color() for ax in drawn[name].figure.axes for line in ax.get_lines()}
        assert colours - {"#9AA5B1"} <= set(METHOD_COLOURS.values())


def test_the_drawn_border_lies_at_the_buffer_distance(drawn, sources: Sources):
    table, body = drawn["fig3"].tables[""], MobileBody(sources.model)
    chosen = np.char.startswith(table["set"].astype(str), "DBB")
    points = np.column_stack([table[f"{axis}_m"][chosen] for axis in "xyz"])[::97]
    d = body.distance(points)
    assert len(d) > 50
    np.testing.assert_allclose(d, 0.15, atol=0.01 + 1e-6)


def test_the_determinant_is_symmetric_about_x_and_the_score_changes_sign(drawn):
    table = drawn["fig5"].tables[""]
    x, determinant, score = table["x_m"], table["determinant_m4prad4"], table["score_m4prad4"]
    np.testing.assert_allclose(determinant / x**2, determinant[0] / x[0] ** 2, rtol=1e-9)
    assert ((score > 0) == (x > 0))[np.abs(x) > 1e-6].all()
    np.testing.assert_allclose(np.abs(score), determinant * table["reachability"], rtol=1e-12)


def test_drawn_fit_of_reachability_has_the_reported_coefficients(drawn):
    drawing = drawn["fig6"]
    table, m = drawing.tables[""], drawing.measured
    fit = m["C"] - m["A_per_m2"] * (table["rho_m"] - m["B_m"]) ** 2
    np.testing.assert_allclose(table["fit"], fit)
    paper = 100 - 525.9 * (table["rho_m"] - 0.575) ** 2
    np.testing.assert_allclose(table["paper"], paper)


def test_force_components_are_orthogonal_and_add_up(drawn, sources: Sources):
    rng, force = np.random.default_rng(3), method.turning(sources)
    for p_b, p_n, f in rng.normal(size=(20, 3, 3)):
        closest, found = force.closest._replace(p_b=p_b), force.acting._replace(p_n=p_n)
        along, across = force._replace(closest=closest, acting=found, f=f).components
        np.testing.assert_allclose(along + across, f, atol=1e-12)
        assert along @ across == pytest.approx(0.0, abs=1e-9)
        assert np.linalg.norm(np.cross(along, p_b - p_n)) == pytest.approx(0.0, abs=1e-9)
    measured = drawn["fig7"].measured
    parts = np.hypot(measured["force_along_line_n"], measured["force_tangential_n"])
    assert parts == pytest.approx(measured["force_n"])


def test_too_large_a_step_loses_the_component_along_the_line(drawn):
    chosen, large = (drawn["fig8"].measured[k] for k in ("chosen", "too large"))
    assert large["alpha_m"] > chosen["alpha_m"]
    assert large["share_along_line"] < 0.5 * chosen["share_along_line"]


def test_drawn_instant_has_the_least_distance(drawn, sources: Sources):
    force = method.force_at(sources, LATERAL, int(sources.distances(LATERAL).argmin()))
    d = sources.runs[LATERAL].trace["d_lm-lEE_m"]
    assert force.closest.d == pytest.approx(d.min(), abs=1e-9)
    height = drawn["fig8"].tables[""]["z_m"]
    assert np.abs(height - force.closest.p_b[2]).max() <= 0.005 + 1e-9


def test_instant_of_figure_7_shows_both_components(sources: Sources):
    def smaller(force: method.Force) -> float:
        return min(float(np.linalg.norm(v)) for v in force.components)

    deepest = method.force_at(sources, LATERAL, int(sources.distances(LATERAL).argmin()))
    assert smaller(method.turning(sources)) >= smaller(deepest) - 1.0 > 0.0


def test_drawn_activation_is_that_of_the_controller(drawn):
    table = drawn["fig10"].tables[""]
    assert table["beta"].tolist() == [activation(d, 0.15, 0.05) for d in table["d_m"]]


def test_lines_of_base_acceleration_are_columns_of_the_log(sources: Sources):
    run = sources.runs[LATERAL]
    np.testing.assert_array_equal(
        approach._avoidance_columns(run, "repulsive")["linear_mps2"], run.trace["base_a_mps2"]
    )
    np.testing.assert_array_equal(
        approach._avoidance_columns(run, "dbb")["linear_mps2"], run.trace["avoidance_a_mps2"]
    )


def test_logged_path_of_the_end_effector_agrees_with_the_kinematics(sources: Sources):
    run = sources.runs[LATERAL]
    path, state = run.trace.of("p_ee"), RobotState(sources.model)
    for k in (0, 77, 199):
        m = state.measurement._replace(
            base_pose=run.trace.of("base_pose")[k], q_m=run.trace.of("q_m")[k]
        )
        state.update(m)
        np.testing.assert_allclose(path[k], state.T_world_ee.translation, atol=1e-12)


def test_closest_points_do_not_depend_on_the_base_pose(sources: Sources):
    run = sources.runs[LATERAL]
    found = sources.closest_points(run.trace.of("q_m")[::50])
    np.testing.assert_allclose([c.d for c in found], run.trace["d_lm-lEE_m"][::50], atol=1e-9)


def test_thinned_border_is_a_sorted_subset(sources: Sources):
    border = construct_dbb(sources.data.clouds["lm-lEE"], 0.15, 0.01)
    thin = density.thinned(border, 500)
    assert len(thin) == 500
    assert (np.diff(thin.heights) >= 0).all()
    assert set(map(tuple, thin.points)) <= set(map(tuple, border.points))


def test_border_of_a_thinned_cloud_has_the_same_share_of_points(sources: Sources):
    cloud = sources.data.clouds["lm-lEE"]
    whole = len(construct_dbb(cloud, 0.15, 0.01))
    thin = len(construct_dbb(density.thinned(cloud, round(0.4 * len(cloud))), 0.15, 0.01))
    assert thin == pytest.approx(0.4 * whole, rel=0.03)


def test_picture_shows_a_limited_number_of_distinct_points():
    rng = np.random.default_rng(0)
    assert method._some(10, rng).tolist() == list(range(10))
    many = method._some(10**5, rng)
    assert len(set(many.tolist())) == len(many) == method._SHOWN


@pytest.mark.slow
def test_snapshots_are_drawn_with_the_paths_of_the_csv(sources: Sources, monkeypatch):
    """Both rows of Figure 13, with four pictures each."""
    monkeypatch.setattr(approach, "_SHARES", (0.0, 0.05, 0.1, 0.2))
    with styled():
        drawing = approach.figure_13.draw(sources)
    pictures = [ax for ax in drawing.figure.axes if ax.images]
    assert len(pictures) == 8
    images = [np.asarray(ax.images[0].get_array()) for ax in pictures]
    assert all(image.std() > 15 for image in images)
    table = drawing.tables[""]
    half = len(table["t_s"]) // 2
    p_ee = sources.runs[LATERAL].trace.of("p_ee")[::10]
    np.testing.assert_array_equal(table["hand_y_m"][:half], p_ee[:, 1])


@pytest.mark.slow
def test_figures_of_the_refrigerator_show_door_and_robot(
    robot: RobotModel, border_data: BorderData
):
    """The run lasts 0.2 s; the shape of the door is magenta."""
    run = short_run(robot, border_data, DOOR, 0.2, physics="planar")
    sources = sources_of(robot, border_data, every([DOOR, DOOR_NONE], run))
    with styled():
        figures = (approach.figure_16, approach.figure_17, approach.figure_18)
        drawings = [figure.draw(sources) for figure in figures]
    _, shapes = (np.asarray(ax.images[0].get_array()) for ax in drawings[0].figure.axes)
    r, g, b = np.moveaxis(shapes.astype(int), -1, 0)
    assert np.mean((r - g > 60) & (b - g > 30)) > 0.01
    assert sum(bool(ax.images) for ax in drawings[1].figure.axes) == 8
    for _, x, y in lines(drawings[2]):
        assert contains(drawings[2].tables[""], x)
        assert contains(drawings[2].tables[""], y)


def test_the_drawn_door_turns_about_its_hinge_by_its_angle():
    door = approach._door()
    hinge = np.array([*door.hinge_position, 0.0])
    for angle in (0.0, 0.7, 1.4):
        run = RunResult({}, {"door_angle_rad": np.array([angle])})
        body, board, _ = approach.refrigerator(run, 0)
        to_middle = (board.mesh.centroid - hinge) * [1.0, 1.0, 0.0]
        assert np.linalg.norm(to_middle) == pytest.approx(door.width / 2)
        along = door.pose(angle).rotation @ [0.0, -door.side, 0.0]
        np.testing.assert_allclose(to_middle / np.linalg.norm(to_middle), along, atol=1e-9)
        assert body.mesh.bounds[0][0] > door.hinge_position[0]


def test_printed_form_is_worse_at_each_departure(
    sources: Sources, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Measures that compare two runs are exceptions, because both are the same run here."""
    monkeypatch.setattr(departures, "_STATES", 4)
    monkeypatch.setattr(departures, "_LINE", 20)
    with styled():
        measured = FIGURES["departures"].draw(sources).measured
    assert measured.keys() > {"jump_radps2", "demand_mps2", "off_at_zero_radps2", "torque_jump_nm"}
    for key, row in measured.items():
        assert row["printed"] > 10.0 * row["here"] or key.startswith("ee_error"), key
