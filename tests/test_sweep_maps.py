"""The maps of a sweep show its numbers."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.patches import Rectangle

from app.robot.model import RobotModel
from app.studies.style import styled
from app.studies.sweep.maps import above_map, polar_map, quantities
from app.studies.sweep.plan import AXIS_OFFSETS
from app.studies.sweep.sweep import write_sweep

ROW: dict[str, Any] = {
    "speed_mps": 0.025,
    "start_clearance_m": 0.17,
    "ee_error_final_m": 1e-6,
    "min_clearance_m": 0.1,
    "contacts": 0,
    "arm_contacts": 0,
    "time_s": 8.0,
    "passed": True,
}
ERROR, CLEARANCE, TIME = quantities([ROW])


def result(controllers: tuple[str, ...] = ("dbb", "barrier")) -> dict[str, Any]:
    """Numbers of a sweep every 30°, where `barrier` fails on the wheel axis."""
    paths, axis, above = [], [], []
    for name in controllers:
        bad = {"ee_error_final_m": 0.06, "time_s": None, "contacts": 2, "min_clearance_m": -0.01}
        for k in range(12):
            fails = name == "barrier" and k in (3, 9)
            row = {**ROW, **(bad if fails else {}), "controller": name}
            if k != 6:
                paths.append({**row, "height_m": 0.3, "direction_deg": 30.0 * k})
        for offset in AXIS_OFFSETS[:-1]:
            row = {**ROW, "controller": name, "height_m": 0.3, "direction_deg": 90.0}
            axis.append({**row, "offset_m": offset})
        for x in (-0.495, 0.0, 0.495):
            above.append({**ROW, "controller": name, "place_x_m": x, "place_y_m": 0.345})
    unreachable = [
        {"kind": "side", "height_m": 0.3, "direction_deg": 180.0, "reason": "too far"},
        {
            "kind": "wheel_axis",
            "height_m": 0.3,
            "direction_deg": 90.0,
            "offset_m": -0.05,
            "reason": "too far",
        },
        {"kind": "above", "place_x_m": 0.495, "place_y_m": -0.345, "reason": "too far"},
    ]
    return {
        "robot": "husky_panda",
        "mode": "tracking",
        "controllers": list(controllers),
        "heights_m": [0.3],
        "speeds_mps": [0.025],
        "step_deg": 30.0,
        "length_m": 0.2,
        "paths": paths,
        "wheel_axis": axis,
        "above": above,
        "unreachable": unreachable,
    }


def bars(ax: Any) -> list[Rectangle]:
    return [bar for container in ax.containers for bar in container]


def middle(bar: Rectangle) -> float:
    """[deg] direction at the middle of a bar."""
    return float(np.degrees(bar.get_x() + bar.get_width() / 2))


@given(st.floats(0.0, 0.5))
def test_an_error_is_red_beyond_a_millimetre_and_blue_within(error: float) -> None:
    r, _, b, _ = ERROR.colour(error)
    assert (r > b) == (error > 0.001)


@given(st.floats(-0.2, 0.5))
def test_a_clearance_is_red_below_the_limit_and_blue_above(clearance: float) -> None:
    r, _, b, _ = CLEARANCE.colour(clearance)
    assert (r > b) == (clearance < 0.03)


@given(st.floats(0.0, 0.6), st.floats(0.0, 0.6))
def test_colour_scales_are_monotonic_and_bounded(a: float, b: float) -> None:
    for quantity in (ERROR, CLEARANCE, TIME):
        low, high = sorted((a, b))
        assert 0.0 <= quantity.share(low) <= quantity.share(high) <= 1.0


def test_each_direction_has_a_bar_that_is_hatched_without_a_value(robot: RobotModel) -> None:
    shown = result()
    with styled():
        figure = polar_map(shown, 0.3, 0.025, robot)
    assert len(figure.axes) == 6
    for k, ax in enumerate(figure.axes):
        middles = sorted(map(middle, bars(ax)))
        np.testing.assert_allclose(middles, np.arange(0.0, 360.0, 30.0), atol=1e-9)
        hatched = {round(middle(bar)) for bar in bars(ax) if bar.get_hatch()}
        assert hatched == ({90, 180, 270} if k == 5 else {180})


def test_directions_in_which_a_controller_fails_are_red_and_long(robot: RobotModel) -> None:
    with styled():
        figure = polar_map(result(), 0.3, 0.025, robot)
    dbb, barrier = (bars(ax) for ax in figure.axes[:2])
    longest = max(bar.get_height() for bar in dbb if not bar.get_hatch())
    failing = [bar for bar in barrier if bar.get_height() > longest and not bar.get_hatch()]
    assert {round(middle(bar)) for bar in failing} == {90, 270}
    assert all(bar.get_facecolor()[0] > bar.get_facecolor()[2] for bar in failing)


def test_the_base_is_drawn_to_scale_with_its_wheel_axis(robot: RobotModel) -> None:
    with styled():
        figure = polar_map(result(("dbb",)), 0.3, 0.025, robot)
    assert len(figure.axes) == 3
    for ax in figure.axes:
        (base,) = (p for p in ax.patches if p.get_label() == "base")
        assert (base.get_width(), base.get_height()) == pytest.approx((0.99, 0.69))
        assert any(np.array_equal(line.get_xdata(), [0, 0]) for line in ax.get_lines())


def test_map_from_above_has_a_square_for_every_place(robot: RobotModel) -> None:
    with styled():
        figure = above_map(result(("dbb",)), 0.025, robot)
    for ax in figure.axes:
        squares = [p for p in ax.patches if type(p) is Rectangle and p.get_fill()]
        middles = [np.add(p.get_xy(), (p.get_width() / 2, p.get_height() / 2)) for p in squares]
        centres = {(round(float(x), 3), round(float(y), 3)) for x, y in middles}
        assert centres == {(-0.495, 0.345), (0.0, 0.345), (0.495, 0.345), (0.495, -0.345)}
        assert sum(bool(p.get_hatch()) for p in squares) == 1


@pytest.mark.slow
def test_files_contain_every_path_and_every_unreachable_start(tmp_path: Path) -> None:
    shown = result()
    names = write_sweep(shown, tmp_path)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(names)
    with (tmp_path / "sweep.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    count = len(shown["paths"]) + len(shown["wheel_axis"]) + len(shown["above"])
    assert len(rows) == count + 3
    assert sum(row["reason"] == "too far" for row in rows) == 3
    assert json.loads((tmp_path / "sweep.json").read_text(encoding="utf-8")) == {
        **shown,
        "files": names,
    }
