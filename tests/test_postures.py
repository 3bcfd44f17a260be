"""The choice of a guiding line for a new robot among many candidates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.config import Config
from app.onboarding import SIDES
from app.onboarding.fit import postures
from app.onboarding.fit.postures import Place, chosen, fault_of_run, find_place
from app.robot.link_pairs import LinkPairs, find_link_pairs
from app.robot.model import RobotModel
from app.robot.shapes import Box
from app.simulation.plants.interface import Contacts
from app.simulation.run import run_scenario, steps_of
from tests.onboarding import FAST_LINES
from tests.robots import husky_panda, with_mobile_shapes

D_B = 0.15  # [m]
INNER = 0.4 * D_B  # [m]


@pytest.fixture(scope="module", autouse=True)
def _few_guesses() -> Iterator[None]:
    """Starts of lines are searched from fewer random postures."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(postures, "_SAMPLES", 1000)
        yield


@cache
def with_buffer(d_b: float) -> RobotModel:
    """The paper's robot with another d_b [m] in its description."""
    config = Config().replace("border.d_b", d_b)
    return RobotModel(husky_panda().description.model_copy(update={"config": config}))


@cache
def pairs_of(model: RobotModel) -> LinkPairs:
    """Link pairs from few samples."""
    return find_link_pairs(model, samples=2000)


def places(nearest: list[float], apart: float = 0.2) -> list[Place]:
    """Lines with these nearest distances [m] to the base and starts `apart` [m] from each other."""
    return [Place((0.0, 0.0, apart * k), (1.0, 0.0, 0.0), d, "") for k, d in enumerate(nearest)]


@pytest.mark.parametrize(
    ("nearest", "expected"),
    [
        ([], None),
        ([0.3, INNER], None),  # none into the inner part
        ([0.3, 0.9 * INNER, -0.02], 1),
        ([-0.02, 0.0], 0),
    ],
)
def test_the_first_line_into_the_inner_part_of_the_buffer_is_chosen(
    nearest: list[float], expected: int | None
) -> None:
    lines = places(nearest)
    assert chosen(lines, D_B) == ("" if expected is None else lines[expected])


def test_the_search_stops_after_the_chosen_line() -> None:
    lines = places([0.3, -0.001])

    def searched() -> Iterator[Place]:
        yield from lines
        raise AssertionError("searched on")

    assert chosen(searched(), D_B) == lines[1]


def test_the_first_line_with_a_yielding_base_is_chosen() -> None:
    lines = places([0.3, -0.01, -0.03, -0.02])
    assert chosen(lines, D_B, lambda line: "" if line is lines[3] else "no") == lines[3]
    assert chosen(lines, D_B, lambda _: "no", anyway=True) == lines[1]
    said = chosen(lines, D_B, lambda line: f"fault {lines.index(line)}")
    assert said == (  # each line with its own measured fault
        "on the line from (0, 0, 0.2) m: fault 1; on the line from (0, 0, 0.4) m: fault 2; "
        "on the line from (0, 0, 0.6) m: fault 3"
    )


def test_only_a_few_lines_are_simulated() -> None:
    tried: list[Place] = []
    for nearest in (-0.01, 0.5 * INNER):
        tried.clear()
        chosen(places([nearest] * 20), D_B, lambda line: tried.append(line) or "no")
        assert 1 < len(tried) < 6


def tried_lines(
    monkeypatch: pytest.MonkeyPatch,
    sides: Sequence[str] = SIDES,
    *,
    carried: Callable[[Any], float] = lambda _: 0.0,
    d_b: float = D_B,
) -> dict[str, list[Place]]:
    """Lines of the paper's robot that are tried, by scenario, if none satisfies the test.

    `carried` returns the uncompensated share for a line's start (x, y, distance to the base) [m].
    """
    tried: dict[str, list[Place]] = {name: [] for name in sides}
    look = postures._Guide._look

    def looked(guide: Any, start: Any, z: float) -> Any:
        found = look(guide, start, z)
        return found and found._replace(carried=carried(start[0]))

    monkeypatch.setattr(postures._Guide, "_look", looked)
    model = with_buffer(d_b)
    for name, lines in tried.items():
        find_place(
            model, pairs_of(model), name, fault=lambda line, lines=lines: lines.append(line) or "no"
        )
    return tried


@pytest.fixture(scope="module")
def lines_of_papers() -> dict[str, list[Place]]:
    with pytest.MonkeyPatch.context() as patch:
        return tried_lines(patch)


def test_no_line_is_run_that_ends_near_an_unsuccessful_one(
    lines_of_papers: dict[str, list[Place]],
) -> None:
    """Such a line may be the same one with a farther start."""
    for lines in lines_of_papers.values():
        assert len(lines) > 1
        ends = [np.add(line.start, line.move) for line in lines]
        for a, b in combinations(ends, 2):
            assert np.linalg.norm(a - b) >= 0.1


def test_a_short_arm_starts_just_outside_the_buffer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Formerly, lines started at least 0.25 m beside the base for any buffer."""
    monkeypatch.setattr(postures, "_FARTHEST", 0.22)
    lines = tried_lines(monkeypatch, ["guiding-lateral"], d_b=0.06)["guiding-lateral"]
    assert lines
    assert all(0.0 < np.abs(line.move).max() < 0.22 for line in lines)


def test_an_arm_that_moves_in_a_plane_has_a_line_in_front_of_its_mount() -> None:
    """For example a gantry; formerly all lines from the front started beside its plane."""
    model = husky_panda()
    mount = model.p_base()
    ways = list(postures._front(MobileBody(model), mount, (0.3,)))
    assert any(start[1] == mount[1] for start, _ in ways)
    assert all((inwards == (-1.0, 0.0, 0.0)).all() for _, inwards in ways)


def test_lines_with_a_compensating_arm_come_first(
    lines_of_papers: dict[str, list[Place]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Kinova's slow joints cannot compensate the base at most heights."""
    sides = ["guiding-lateral"]
    left = tried_lines(monkeypatch, sides, carried=lambda at: float(at[1] > 0.0))
    [first, *_], [other, *_] = lines_of_papers[sides[0]], left[sides[0]]
    assert first.start[1] > 0.0 > other.start[1]


def test_lines_with_equal_nearest_distance_keep_their_order() -> None:
    """Distances count as equal to a millimetre: left stays before right for a symmetric robot."""

    def line(nearest: float) -> postures._Candidate:
        return postures._Candidate(
            (0.0, 0.6, 0.4), np.array([0.0, -1.0, 0.0]), 0.3, 0.1, nearest, 0.0
        )

    left, right, deeper, met, further = map(line, (0.0302, 0.0298, 0.028, 0.0, -0.02))
    ranked = [left, right, deeper, met, further]
    ranked.sort(key=lambda each: each.rank)
    assert [each.nearest for each in ranked] == [0.0, -0.02, 0.028, 0.0302, 0.0298]


def test_a_line_that_ends_farther_inside_replaces_a_shallow_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """On a line that ends 0.2 m beside the base, the arm's distance stays above `INNER` d_b."""
    monkeypatch.setattr(postures, "_FARTHEST", 0.35)
    monkeypatch.setattr(postures, "_OUTSIDE", 0.2)
    monkeypatch.setattr(postures, "_LEFT_OVER", (0.2, 0.025))
    monkeypatch.setattr(postures, "_HEIGHTS", ((0.8, 0.0),))
    monkeypatch.setattr(postures, "_front", lambda *_: iter(()))
    model = with_buffer(0.14)
    pairs = pairs_of(model)
    found = find_place(model, pairs, "guiding-lateral")
    np.testing.assert_allclose(found.move, (0.0, -0.325, 0.0), atol=1e-9)
    assert "can use none of the possible" in find_place(model, pairs, "guiding-front")


_figures: dict[tuple[Place, float], dict[str, Any]] = {}


def figures_of_run(data: BorderData, place: Place, d_b: float) -> dict[str, Any]:
    """Figures of the paper's robot guided along a line, simulated once for all tests."""
    if (place, d_b) not in _figures:
        line = FAST_LINES["guiding-lateral"].changed(start=place.start, move=place.move)
        config = Config().replace("border.d_b", d_b)
        run = run_scenario(husky_panda(), data, line, config, physics="kinematic")
        _figures[place, d_b] = run.figures
    return _figures[place, d_b]


@pytest.mark.parametrize(
    ("move", "least", "d_b"),
    [
        (-0.25, 0.03, D_B),
        (-0.02, 0.03, D_B),
        (-0.25, 0.1, D_B),
        (-0.15, 0.03, D_B),
        (-0.1, 0.03, 0.06),
    ],
)
def test_a_base_gives_way_if_it_moves_and_the_clearance_suffices(
    move: float, least: float, d_b: float, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The paper's line, shorter lines, a too large required clearance, and a narrow buffer."""
    monkeypatch.setattr(postures, "CLEARANCE", least)
    monkeypatch.setattr(postures, "LINES", FAST_LINES)
    place = Place((0.3, 0.72, 0.3), (0.0, move, 0.0), 0.0, "")
    run = figures_of_run(border_data, place, d_b)
    good = run["base_displacement_m"] >= d_b / 3 and run["min_clearance_m"] >= least
    fault = fault_of_run(with_buffer(d_b), border_data, "guiding-lateral", place)
    assert bool(fault) != good
    if run["min_clearance_m"] < least:
        assert fault == f"lm-lEE comes nearer than {least:g} m"
    elif not good:
        moved = f"the base moves by {run['base_displacement_m']:.3f} m instead of {d_b / 3:.3f} m"
        assert moved in fault
    assert good == (move < -0.02 and least == 0.03 and d_b == D_B)


def test_a_base_that_returns_before_the_end_has_not_given_way(
    border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A Stretch had moved by 0.051 m when its end-effector stopped, and by 0.012 m at the end."""
    place = Place((0.3, 0.72, 0.3), (0.0, -0.25, 0.0), 0.0, "")

    def back(*args: Any) -> Iterator[Any]:
        for session, step in steps_of(*args):
            if step.t > 2.9:
                truth = step.truth._replace(base_pose=np.zeros(3))
                step = step._replace(truth=truth)
            yield session, step

    monkeypatch.setattr(postures, "LINES", FAST_LINES)
    monkeypatch.setattr(postures, "steps_of", back)  # without this patch, the base gives way
    assert fault_of_run(with_buffer(D_B), border_data, "guiding-lateral", place)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        (lambda step: {"distances": np.append(step.distances[:-1], -0.001)}, "l2-lEE overlaps"),
        (lambda step: {"contacts": Contacts(arm_arm=True)}, "links touch"),
    ],
)
def test_a_run_in_which_the_arm_meets_itself_is_refused(
    changes: Any, fault: str, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A person folded a weak arm (Alicia-D) into itself on the line that was chosen for it."""
    place = Place((0.3, 0.72, 0.3), (0.0, -0.25, 0.0), 0.0, "")

    def folded(*args: Any) -> Iterator[Any]:
        for session, step in steps_of(*args):
            yield session, step._replace(**changes(step)) if step.t > 0.5 else step

    monkeypatch.setattr(postures, "LINES", FAST_LINES)
    monkeypatch.setattr(postures, "steps_of", folded)  # without this patch, the line has no fault
    found = fault_of_run(with_buffer(D_B), border_data, "guiding-lateral", place)
    assert found.startswith(fault)


def test_a_run_through_the_floor_names_the_floor(
    border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postures, "LINES", FAST_LINES)
    monkeypatch.setattr(postures, "_LOWEST", 0.3)
    place = Place((0.3, 0.72, 0.3), (0.0, -0.25, 0.0), 0.0, "")
    fault = fault_of_run(with_buffer(D_B), border_data, "guiding-lateral", place)
    assert fault == "the arm comes nearer than 0.3 m to the floor"


def test_a_missing_line_names_the_obstacles_and_the_largest_buffer_distance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Formerly "it is too short for this --buffer-distance", without a value."""
    monkeypatch.setattr(postures, "_HEIGHTS", ((0.8, 0.0),))
    name = "guiding-lateral"

    def found(d_b: float) -> Place | str:
        return find_place(with_buffer(d_b), pairs_of(with_buffer(d_b)), name)

    said = found(0.3)
    assert "end-effector – base would be inside its buffer of " in said
    least = float(said.partition("; --buffer-distance ")[2].removesuffix(" can give a line"))
    assert isinstance(found(least), Place)
    assert isinstance(found(round(least + 0.01, 2)), str)


def test_a_missing_line_names_the_missing_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(postures, "_FARTHEST", 2.0)
    monkeypatch.setattr(postures, "_OUTSIDE", 1.8)
    found = find_place(husky_panda(), pairs_of(husky_panda()), "guiding-lateral")
    assert "none of the possible lines: out of the arm's reach by about 1.4" in found
    assert "a smaller --buffer-distance probably does not help" in found


def test_a_line_just_above_the_base_is_tried_if_no_other_height_works(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A short arm on a low base, for example, cannot reach the heights that are tried first."""
    monkeypatch.setattr(postures, "_HEIGHTS", ((0.0, 3.0),))  # out of reach
    found = find_place(husky_panda(), pairs_of(husky_panda()), "guiding-lateral")
    top = float(MobileBody(husky_panda()).upper[2])
    assert found.start[2] == pytest.approx(top + 0.025, abs=1e-3)


def test_a_line_leads_to_the_part_of_the_base_at_its_height() -> None:
    """A base on a wide plate; beside the plate, the trunk is out of the arm's reach."""
    trunk = husky_panda().description.mobile_body.shapes[0]
    plate = Box(type="box", xyz_m=(0.0, 0.0, -0.1), size_m=(1.6, 1.2, 0.04))
    model = with_mobile_shapes((trunk, plate))
    place = find_place(model, pairs_of(model), "guiding-lateral")
    assert place.nearest < INNER
    assert abs(place.start[1]) < 0.6 + 0.25  # [m] nearer than any start of a line to the plate


def test_the_nearest_distance_equals_a_run_without_avoidance(
    border_data: BorderData,
) -> None:
    """The paper's robot is pulled slowly from the side and the front."""
    model, config = husky_panda(), Config()
    for name in SIDES:
        place = find_place(model, border_data.pairs, name)
        line = FAST_LINES[name].changed(start=place.start, move=place.move)
        run = run_scenario(model, border_data, line, config, controller="none", physics="kinematic")
        assert place.nearest < INNER
        assert run.figures["min_clearance_m"] == pytest.approx(place.nearest, abs=0.005)
