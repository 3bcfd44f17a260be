"""From a URDF to a valid robot, and checks that detect an invalid one."""

from __future__ import annotations

import base64
import re
import shutil
import sys
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from itertools import combinations
from pathlib import Path
from queue import Queue
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import tomlkit
import trimesh
from pydantic import ValidationError

from app.border import cache
from app.border.cache import BorderData
from app.border.sampling import QUICK, SamplingConfig
from app.cli import serve
from app.control.buffer_watch import BufferReading
from app.dashboard import job
from app.errors import AssetError, DescriptionError, RobotFileError, UnreachableError
from app.jobs.pool import ALONE, Workers
from app.onboarding import check as checks
from app.onboarding import new_robot, warn
from app.onboarding.check import (
    arm_row,
    base_row,
    border_row,
    dynamics_row,
    limits_row,
    ready_row,
    run_row,
)
from app.onboarding.fit import grouping, postures
from app.onboarding.fit.bodies import ArmFitter, FittedBody, fit_base
from app.onboarding.fit.convex import Fit
from app.onboarding.fit.grouping import Grouping, detection_of, find_grouping
from app.onboarding.fit.meetings import (
    Meetings,
    Postures,
    _close_pairs,
    sample_meetings,
    watching_buffer,
    with_stops,
)
from app.onboarding.fit.postures import Place, Point
from app.onboarding.fit.travel import filled, held_by
from app.onboarding.fit.units import make_units, meshes_meet, units_of_links
from app.onboarding.new_robot import finish, parse
from app.onboarding.read.source import mesh_address
from app.onboarding.record import NewRobot
from app.onboarding.report import draw, report_html
from app.onboarding.request import Request
from app.onboarding.warn import Carried, warnings_of
from app.onboarding.write import (
    compiled,
    description,
    description_text,
    mesh_name,
    rebased_urdf,
)
from app.robot import assets
from app.robot.assets import ASSETS, package_roots, resolve_package_uri, resolved_urdf, robot_names
from app.robot.bases.kind import FORWARD
from app.robot.description import RobotDescription, load_description, load_robot
from app.robot.link_pairs import candidate_pairs, find_link_pairs
from app.robot.model import RobotModel
from app.robot.shapes import Sphere
from app.simulation.plants.collision_shapes import body_contact_pairs
from app.simulation.scenarios import scenario_by_name, scenario_of
from app.simulation.scenarios.start import StartSolver
from tests.onboarding import (
    ARM_JOINTS,
    arm,
    cart,
    cube,
    few_postures,
    few_samples,
    joint,
    line_without_a_run,
    link,
    robot,
    solid,
    with_mesh,
    write,
    zipped,
)
from tests.robots import husky_panda

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def _few_postures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        few_postures(patch)
        yield


@pytest.fixture(scope="module")
def reported() -> dict[str, list[float]]:
    """Reported shares of progress while the toy robot was made, by activity."""
    return {}


@pytest.fixture(scope="module")
def finished(
    tmp_path_factory: pytest.TempPathFactory, reported: dict[str, list[float]]
) -> tuple[NewRobot, BorderData]:
    """The toy robot from a zip, made with few samples, with its own folder and cache."""
    folder = tmp_path_factory.mktemp("toy")
    text = with_mesh(robot([*cart(), *arm()]), "package://toy/meshes/m.stl")
    path = zipped(folder, {"toy/u/toy.urdf": text, "toy/meshes/m.stl": cube(), "toy/LICENSE": ""})
    with few_samples(folder) as sampling:
        request = Request(urdf=str(path), base="base", tip="hand", out=folder / "toy")
        return finish(
            request,
            processes=1,
            sampling=sampling,
            tell=lambda text: reported.update({text: []}),
            on_progress=lambda share: [*reported.values()][-1].append(share),
        )


@pytest.fixture(scope="module")
def made(finished: tuple[NewRobot, BorderData]) -> NewRobot:
    return finished[0]


def written(made: NewRobot, **changes: object) -> RobotModel:
    """The model of the robot `made`, from its files, with `changes` of description fields."""
    folder = made.request.out
    stated = load_description(folder / "robot.toml")
    content = stated.model_dump() | {"urdf": str(folder / "robot.urdf")} | changes
    return RobotModel(RobotDescription.model_validate(content))


def test_new_robot_writes_a_complete_folder_and_no_other_file(made: NewRobot) -> None:
    folder = made.request.out
    files = {path.name for path in folder.iterdir()}
    assert files == {
        "robot.toml",
        "robot.urdf",
        "SOURCES.md",
        "report.html",
        "bodies.html",
        "package",
    }
    assert not [p for p in folder.parent.iterdir() if p.name.startswith(".")]
    text = (folder / "robot.toml").read_text()
    assert "wheel_radius_m = 0.1 # measured" in text
    assert "max_effort = [60.0, 60.0, 60.0, 60.0, 60.0, 60.0] # from the URDF" in text
    assert "traction_limit_n" in text
    assert "# assumed" in text
    assert not made.content["unwatched"]
    assert "[unwatched]" not in text  # no table without entries is written


def test_robot_from_a_zip_contains_its_meshes_and_can_be_moved(
    made: NewRobot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A robot in the user's folder is listed."""
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    assert "toy" not in robot_names()
    shutil.copytree(made.request.out, tmp_path / "toy")
    assert {"toy", "husky_panda"} <= set(robot_names())
    mesh = tmp_path / "toy" / "package" / "toy" / "meshes" / "m.stl"
    assert f'filename="{mesh}"' in resolved_urdf(load_robot("toy"))
    assert (tmp_path / "toy" / "package" / "toy" / "LICENSE").is_file()
    sources = (tmp_path / "toy" / "SOURCES.md").read_text()
    assert "toy.zip: toy/u/toy.urdf" in sources
    for text in (sources, (tmp_path / "toy" / "robot.urdf").read_text()):
        assert str(made.request.out.parent) not in text
    assert not any("absolute path" in warning for warning in made.warnings)
    mesh.unlink()
    urdf = tmp_path / "toy" / "robot.urdf"
    for name in ("package/toy/meshes/m.stl", str(mesh)):
        with pytest.raises(AssetError, match=f"no mesh '{name}'"):
            resolved_urdf(load_robot("toy"))
        urdf.write_text(urdf.read_text().replace(name, str(mesh)))


def test_own_mesh_is_named_relative_to_the_robot_even_on_the_import_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    mesh = tmp_path / "some_robots" / ".toy-x" / "package" / "m.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_bytes(b"solid")
    address = mesh_address(str(mesh), tmp_path)
    assert address == "package://some_robots/.toy-x/package/m.stl"
    for reference in (address, str(mesh)):
        assert mesh_name(mesh_address(reference, tmp_path), mesh.parent.parent) == "package/m.stl"


@pytest.mark.parametrize("reference", ["src/m.stl", "package://src/m.stl"])
def test_folder_of_the_current_directory_is_no_installed_package(
    reference: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`python -m app` searches that folder too, but elsewhere the address would be invalid."""
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.chdir(tmp_path)
    mesh = tmp_path / "src" / "m.stl"
    mesh.parent.mkdir()
    mesh.write_bytes(b"solid")
    assert mesh_address(reference, tmp_path) == str(mesh)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])  # an editable installation
    assert mesh_address(reference, tmp_path) == "package://src/m.stl"


@pytest.mark.parametrize("folder", ["a & b", 'a"b', "toy", "link", "../toy-other/../toy"])
def test_own_meshes_are_named_relative_to_the_robots_folder(tmp_path: Path, folder: str) -> None:
    """The folder's name can have special characters, and its path a symbolic link or `..`."""
    beside = tmp_path / "toy-other" / "m.stl"
    beside.parent.mkdir()
    beside.write_bytes(b"solid")
    (tmp_path / "toy").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "toy")
    home = beside.parent / folder if folder.startswith("..") else tmp_path / folder
    (home / "package").mkdir(parents=True)
    (home / "package" / "m.stl").write_bytes(b"solid")
    real = home.resolve()
    mesh = Path("package") / "m.stl"
    for reference in (
        mesh,
        Path("..") / "toy-other" / ".." / real.name / mesh,
        home / mesh,
        real / mesh,
    ):
        assert mesh_name(mesh_address(str(reference), home), home) == "package/m.stl"
    assert mesh_name(mesh_address(str(beside), home), home) == str(beside)
    assert mesh_name(mesh_address("../toy-other/m.stl", real), home) == str(beside)


def test_description_matches_the_urdf_placed_on_the_floor(made: NewRobot) -> None:
    model = written(made)
    assert model.description.arm.joints == ARM_JOINTS
    np.testing.assert_allclose(model.p_base(), [0.1, 0.0, 0.25], atol=1e-9)
    base = model.description.base
    assert base.mass_kg == pytest.approx(30 + 2 + 3 + 2 + 2 + 1.5 + 1 + 1 + 0.7)
    assert (base.wheel_radius_m, base.half_track_m) == (pytest.approx(0.1), pytest.approx(0.2))


def test_checks_of_bodies_and_dynamics_pass(made: NewRobot) -> None:
    model = written(made)
    engines = (dynamics_row(model, "pybullet"), dynamics_row(model, "mujoco"))
    for row in (*engines, limits_row(model), base_row(model)):
        without = row.name == "pybullet" and find_spec("pybullet") is None
        assert row.outcome == ("warned" if without else "passed"), row
    row = arm_row(model)  # with few samples the bodies may miss a few of the new postures
    assert row.numbers["missed"] <= 0.01 * row.numbers["collisions"], row


def test_base_body_smaller_than_its_meshes_fails(made: NewRobot) -> None:
    bodies = [body.model_dump() for body in written(made).description.bodies]
    size = bodies[0]["shapes"][0]["size_m"]
    bodies[0]["shapes"][0]["size_m"] = (size[0] - 0.1, size[1], size[2])
    row = base_row(written(made, bodies=bodies))
    assert row.outcome == "failed"
    assert row.numbers["sticks_out_m"] == pytest.approx(0.05, abs=2e-3)


def test_end_effector_body_smaller_than_its_link_fails(
    made: NewRobot,
) -> None:
    bodies = [body.model_dump() for body in written(made).description.bodies]
    bodies[-1]["shapes"] = [{"type": "sphere", "radius_m": 0.01}]
    row = arm_row(written(made, bodies=bodies))
    assert row.outcome == "failed"
    assert row.numbers["missed"] > 0
    assert "do not enclose their colliding links" in row.text


def test_new_robot_and_check_robot_report_the_same_undetected_collisions(made: NewRobot) -> None:
    row = arm_row(written(made))
    assert row.numbers["colliding_poses"] > 100
    assert row.numbers["unseen_share"] == pytest.approx(made.detection.share, abs=2e-3)
    assert row.numbers["colliding_poses"] == pytest.approx(made.detection.postures, rel=5e-3)
    assert row.numbers["collisions"] == pytest.approx(made.detection.watched, rel=5e-3)


def test_collision_is_undetected_if_no_watched_pair_of_bodies_overlaps(
    made: NewRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With fewer monitored pairs, more collisions are undetected; without any pair, all are."""
    monkeypatch.setattr(grouping, "TEST_POSTURES", 500)
    # With more postures, only the hulls would overlap in a few of them.
    monkeypatch.setattr(grouping, "ENOUGH", 0)
    pairs = [pair.name for pair in candidate_pairs(written(made))]
    rows = [
        arm_row(written(made, unwatched=dict.fromkeys(names, "test")))
        for names in ([], pairs[:1], pairs[:3], pairs)
    ]
    none, one, three, every = [row.numbers["unseen_share"] for row in rows]
    assert none < one <= three < every == 1.0
    assert rows[-1].outcome == "failed"
    assert rows[-1].numbers["missed"] == 0


def test_rare_collisions_are_sampled_with_more_postures(made: NewRobot) -> None:
    """A Stretch has only 114 collisions in 6,000 postures: too few for the undetected share."""
    units, options = made.meetings.units, {"seed": 5, "d_b": 0.15, "counted": ()}
    model = written(made)
    few = sample_meetings(model, units, samples=300, **options)
    hits = (few.collides.any(axis=1) & few.random.possible).sum()
    more = sample_meetings(model, units, samples=300, enough=int(hits) + 1, **options)
    assert len(few.random.q_m) == 300 < len(more.random.q_m)
    np.testing.assert_array_equal(more.random.q_m[:300], few.random.q_m)
    assert (more.collides.any(axis=1) & more.random.possible).sum() > hits
    same = sample_meetings(model, units, samples=300, enough=int(hits), **options)
    assert len(same.random.q_m) == 300


def test_search_for_lines_reports_progress_continuously(
    finished: tuple[NewRobot, BorderData], reported: dict[str, list[float]]
) -> None:
    """Each side takes seconds, so progress by whole sides would be too coarse."""
    shares = reported["searching lines for guiding"]
    assert shares == sorted(shares)
    assert shares[0] < 0.01
    assert shares[-1] == 1.0
    for begin in (0.0, 0.5):  # within both sides
        assert len({share for share in shares if begin < share < begin + 0.5}) > 10


def test_worker_processes_give_the_same_results_as_one_process(
    finished: tuple[NewRobot, BorderData], caplog: pytest.LogCaptureFixture
) -> None:
    made, data = finished
    options = {"samples": 300, "seed": 5, "d_b": 0.15}
    here = sample_meetings(made.model, made.meetings.units, **options)
    side = ("guiding-lateral", made.model, data, False)
    with Workers(tuple, 2) as workers:
        there = sample_meetings(made.model, made.meetings.units, **options, workers=workers)
        shares: list[float] = []
        lines = workers.map(line_without_a_run, [side], shares.append, tells=True)
        assert [*lines] == [line_without_a_run(None, side, lambda _: None)]
    assert shares == sorted(shares)
    assert len({*shares}) > 10
    for ours, theirs in ((here.random, there.random), (here.rare, there.rare)):
        for a, b in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(a, b)
    assert not caplog.records, "the workers must do the work"


def test_meshes_overlap_only_where_hulls_do_and_not_inside_a_hollow_one(made: NewRobot) -> None:
    """The toy's shapes equal their hulls; the hollow base is a tiny triangle."""
    model, geometry = written(made), made.parsed.geometry
    units = tuple(u for each in units_of_links(model, geometry).values() for u in each)
    base, hand = units[0], units[-1]
    met = sample_meetings(model, units, samples=300, seed=5, d_b=0.15, counted=())
    posture = met.random.q_m
    hulls = met.random.distances[:, met.pairs.index((base.index, hand.index))] <= 0.0
    links, touching = meshes_meet(model, base, hand, geometry, posture)
    assert ("base", "hand") in links
    bare = {**geometry, "left_wheel": geometry["left_wheel"]._replace(shapes=())}
    shaped, _ = meshes_meet(model, base, hand, bare, posture[:1])
    assert shaped == [pair for pair in links if pair[0] != "left_wheel"]
    assert not touching[:, [pair != ("base", "hand") for pair in links]].all(axis=0).any()
    meshes = touching.any(axis=1)
    assert hulls.sum() > 10
    assert not (meshes & ~hulls).any()
    assert meshes.sum() > 0.7 * hulls.sum()  # otherwise inside the base
    flat = trimesh.Trimesh([[0, 0, -1], [1e-3, 0, -1], [0, 1e-3, -1]], [[0, 1, 2]])
    hollow = {
        link: each._replace(shapes=tuple(shape._replace(mesh=flat) for shape in each.shapes))
        for link, each in geometry.items()
    }
    hollow |= {link: geometry[link] for link in hand.links}
    assert not meshes_meet(model, base, hand, hollow, posture)[1].any()


def test_arm_without_collisions_has_nothing_to_show(
    made: NewRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each joint stays within 1e-3 rad of the ready posture, where no body is near."""
    monkeypatch.setattr(grouping, "ENOUGH", 0)  # more postures would have no collision either
    arm = written(made).description.arm
    ready = np.array(arm.ready_position)
    held = {"position_lower": tuple(ready - 1e-3), "position_upper": tuple(ready + 1e-3)}
    row = arm_row(written(made, arm=arm.model_dump() | held))
    assert row.outcome == "nothing to show"


def test_bodies_that_do_not_enclose_their_links_are_rejected(
    made: NewRobot, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    blind = made.detection._replace(blind=("l1-lEE",), undetected=0)
    fits = [made.bodies, made.bodies[:-1], made.bodies[:-1]]
    monkeypatch.setattr(
        new_robot, "find_grouping", lambda *_, **__: Grouping(fits.pop(0), made.verdict)
    )
    monkeypatch.setattr(new_robot, "detection_of", lambda *_: blind)
    urdf = str(write(tmp_path, robot([*cart(), *arm()])))
    request = Request(urdf=urdf, base="base", tip="hand", out=tmp_path / "toy")
    with (
        few_samples(tmp_path),
        pytest.raises(RobotFileError, match=r"l1-lEE do not enclose .*--bodies other than 3 and 4"),
    ):
        finish(request)


@pytest.mark.parametrize(
    ("counts", "fits", "chosen"), [((0,), 1, 0), ((3, 0), 2, 0), ((3, 1, 2), 3, 1)]
)
def test_bodies_are_fitted_again_if_new_postures_show_a_gap(
    made: NewRobot,
    monkeypatch: pytest.MonkeyPatch,
    counts: tuple[int, ...],
    fits: int,
    chosen: int,
) -> None:
    """TIAGo's bodies missed one collision in 600."""
    path, left, seeds = made.request.out / "robot.urdf", list(counts), list[int]()
    found = Grouping(made.bodies, made.verdict)
    monkeypatch.setattr(
        new_robot, "sample_meetings", lambda *_, seed, **__: seeds.append(seed) or made.meetings
    )
    monkeypatch.setattr(new_robot, "find_grouping", lambda *_, **__: found)
    monkeypatch.setattr(
        new_robot,
        "detection_of",
        lambda *_: made.detection._replace(undetected=left.pop(0)),
    )
    bare = compiled(description(made.request, made.parsed), path)
    work = new_robot._Work(
        ALONE, lambda _: None, lambda _: None, lambda _: pytest.fail("no border")
    )
    made_again = new_robot._embodied(made.request, made.parsed, bare, path, work)
    assert made_again.detection.undetected == chosen
    assert len({*seeds}) == fits


@pytest.mark.parametrize(("found", "count"), [([4], None), ([4, 5], 5), ([5, 4], 5), ([7, 7], 6)])
def test_third_fit_has_one_body_more_than_the_others(
    made: NewRobot, found: list[int], count: int | None
) -> None:
    """The fits of a youBot had 4, 3 and 4 bodies; only five detect all collisions."""
    assert new_robot._count(made.request, made.meetings.units, found) == count


def test_arm_that_cannot_reach_the_base_gets_no_lines_and_no_warning(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    text = robot([*cart(), *arm()]).replace('xyz="0.15 0 0.1"', 'xyz="0.15 0 3.0"')
    request = Request(urdf=str(write(tmp_path, text)), base="base", tip="hand", out=tmp_path / "t")
    with few_samples(tmp_path) as sampling:
        for module in (new_robot, grouping):  # far from the base, collisions are rare
            monkeypatch.setattr(module, "ENOUGH", 20)
        high, data = finish(request, processes=1, sampling=sampling)
    assert not data.pairs.mobile
    assert not [*high.reach, *high.places, *high.lacking, *written(high).description.lines]
    assert not any("line" in warning for warning in high.warnings)


def test_pair_that_hardly_ever_meets_may_have_no_border_points(
    finished: tuple[NewRobot, BorderData],
) -> None:
    """The exact offset replaces the points, as for a Stretch whose tube hardly meets its base."""
    robot, data = finished
    model, (first, *others) = written(robot), data.clouds

    def without(*names: str) -> str:
        clouds = {name: data.clouds[name] for name in names}
        bare = {
            k: replace(c, distances=np.full_like(c.distances, 60_000)) for k, c in clouds.items()
        }
        row = border_row(model, replace(data, clouds={**data.clouds, **bare}))
        assert row.numbers.items() >= {f"points_{name}": 0.0 for name in names}.items()
        return row.outcome

    assert others
    assert without(first) == without() != "failed"
    assert without(first, *others) == "failed"


def test_rarely_colliding_pair_is_sampled_separately(made: NewRobot) -> None:
    model = written(made)
    few = sample_meetings(model, made.meetings.units, samples=60, seed=3, d_b=0.15)
    never = [
        k
        for k, pair in enumerate(few.pairs)
        if pair not in few.close and not (few.random.distances[:, k] <= 0.0).any()
    ]
    met = [k for k in never if (few.rare.distances[:, k] <= 0.0).any()]
    assert met
    for k in met:
        assert few.met[few.pairs[k]].any()
    assert (few.rare.q_m >= model.q_lower).all()
    assert (few.rare.q_m <= model.q_upper).all()


@pytest.mark.parametrize(("share", "outcome"), [(1.0, "passed"), (0.1, "nothing to show")])
def test_line_outside_the_buffer_has_nothing_to_show(
    finished: tuple[NewRobot, BorderData],
    share: float,
    outcome: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With short runs."""
    monkeypatch.setattr(
        "app.simulation.scenarios.scenario_of",
        lambda *of: scenario_of(*of).changed(duration=3.0),
    )
    made, data = finished
    lines = {n: place.model_dump() for n, place in written(made).description.lines.items()}
    line = lines["guiding-front"]
    line["move_m"] = tuple(share * x for x in line["move_m"])
    row = run_row(written(made, lines=lines), data, "guiding-front")
    assert row.outcome == outcome, row
    inside = row.numbers["min_clearance_without_m"] < 0.075
    assert inside is (outcome == "passed")


@pytest.mark.parametrize(
    ("lost", "bare", "near", "moved", "needed", "touching", "outcome"),
    [
        (0.0, 0.02, 0.1, 0.01, 0.1, (), "failed"),
        (0.0, 0.07, 0.1, 0.01, 0.1, (), "failed"),
        (0.0, 0.08, 0.1, 0.01, 0.1, (), "nothing to show"),
        (1.0, 0.02, 0.1, 0.01, 0.1, (), "warned"),
        (1.0, 0.02, 0.02, 0.01, 0.1, (), "failed"),
        (0.0, 0.02, 0.1, 0.2, 0.1, (), "passed"),
        (0.0, 0.02, 0.1, 0.2, np.inf, (), "warned"),
        (0.0, 0.08, 0.1, 0.2, np.inf, (), "nothing to show"),
        (0.0, 0.02, 0.1, 0.2, 0.1, ("in_contact", "floor_contact"), "failed"),
    ],
    ids=[
        "compensates",
        "inner half",
        "outer half",
        "cannot compensate",
        "cannot, and near",
        "moves away",
        "buffer too small",
        "too small, and outer half",
        "two contacts in one step",
    ],
)
def test_outcome_of_a_guiding_run_depends_on_base_arm_and_buffer(
    finished: tuple[NewRobot, BorderData],
    monkeypatch: pytest.MonkeyPatch,
    lost: float,
    bare: float,
    near: float,
    moved: float,
    needed: float,
    touching: tuple[str, ...],
    outcome: str,
) -> None:
    """The runs are replaced by their figures, and the contacts of the first of two steps."""
    from app.simulation import run

    monkeypatch.setattr(warn, "carried_ee", lambda _: (Carried(FORWARD, 0.5, lost, lost),))

    def figures(*_: object, controller: str = "dbb", **__: object) -> SimpleNamespace:
        least = bare if controller == "none" else near
        small, base = needed > 0.15, {"solver_failures": 0, "base_displacement_m": moved}
        return SimpleNamespace(
            figures=base | {"min_clearance_m": least},
            trace=SimpleNamespace(
                buffer=BufferReading(0.1, needed, 0.1, needed, small, small),
                of=lambda quantity: np.array([quantity in touching, False]),
            ),
        )

    monkeypatch.setattr(run, "run_scenario", figures)
    row = run_row(written(finished[0]), finished[1], "guiding-front")
    assert row.outcome == outcome
    assert row.numbers["contacts"] == bool(touching)
    still = moved < 0.05 and bare < 0.075 and near > 0.05
    assert ("moves away by less than" in row.text) is still
    assert ("is too small" in row.text) is (outcome == "warned" and needed > 0.15)


def test_exception_in_a_check_is_a_failure_of_its_row(
    made: NewRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    def limits_row(_: RobotModel) -> None:
        raise RuntimeError("more joints than it can hold")

    monkeypatch.setattr(checks, "limits_row", limits_row)
    rows = checks.check_robot(written(made).description, runs=False)
    reported = next(row for row in rows if row.name == "limits")
    assert (reported.outcome, reported.text) == (
        "failed",
        "RuntimeError: more joints than it can hold",
    )


def test_robot_made_for_another_buffer_is_checked_with_that_buffer(
    finished: tuple[NewRobot, BorderData],
) -> None:
    made, data = finished

    def beyond(d_b: float) -> float:
        request = replace(made.request, d_b=d_b)
        config = tomlkit.parse(description_text(description(request, made.parsed), "a robot"))
        model = written(made, config=config.get("config", {}))
        return ready_row(model, data).numbers["beyond_buffer_m"]

    assert beyond(0.10) - beyond(0.15) == pytest.approx(0.05)


def test_ready_posture_at_a_joint_limit_is_warned_of_also_without_pairs(
    finished: tuple[NewRobot, BorderData],
) -> None:
    made, data = finished
    model, alone = (
        written(made),
        replace(data, pairs=replace(data.pairs, mobile=(), manipulator=())),
    )
    assert ready_row(model, alone).outcome == "passed"
    model.q_lower = np.array(model.description.arm.ready_position)
    assert ready_row(model, alone).outcome == "warned"


def test_ready_posture_is_outside_the_buffer_and_within_the_limits(made: NewRobot) -> None:
    assert made.ready.beyond_buffer > 0.05  # [m] beyond the buffer
    span = np.subtract(made.parsed.limits.upper, made.parsed.limits.lower)
    left = np.minimum(
        made.ready.q_m - made.parsed.limits.lower, made.parsed.limits.upper - made.ready.q_m
    )
    assert (left >= 0.09 * span).all()


def test_report_shows_bodies_pairs_and_warnings(
    finished: tuple[NewRobot, BorderData],
) -> None:
    made, data = finished
    page = (made.request.out / "report.html").read_text()
    pictures = re.findall(r'src="data:image/png;base64,([^"]+)"', page)
    assert len(pictures) >= 2
    assert all(base64.b64decode(each).startswith(b"\x89PNG") for each in pictures)
    for pair in data.pairs.all:
        assert pair.name in page
    for warning in made.warnings:
        assert warning.split("'")[0][:40] in page
    false = made.verdict.overlap
    assert false.keys() >= made.verdict.near.keys()
    monitored = [false[name] for name in made.verdict.near]
    assert max(monitored) <= made.verdict.false <= sum(monitored)
    for name in made.verdict.near:
        assert re.search(rf"<td>{name}</td>.*<td>{false[name]:.1%}</td>", page)


def test_volume_of_a_body_is_compared_with_that_of_all_its_links(made: NewRobot) -> None:
    """A tiny part has a large ratio of its own, but adds little volume."""
    hand, tiny = made.bodies[-1], Fit(Sphere(type="sphere", radius_m=0.01), 4e-6, 100.0, 0.0)
    for fits, reported in (((*hand.fits, tiny), 0), ((tiny,), 1)):
        bodies = [*made.bodies[:-1], hand._replace(fits=fits)]
        found = [each for each in warnings_of(replace(made, bodies=bodies)) if "times the" in each]
        assert len([each for each in found if each.startswith("lEE")]) == reported


def test_pair_that_often_overlaps_without_a_collision_is_reported(made: NewRobot) -> None:
    for share, reported in ((0.05, 0), (0.25, 1)):
        overlap = dict.fromkeys(made.verdict.overlap, 0.0) | {"lm-lEE": share}
        often = replace(made, verdict=made.verdict._replace(overlap=overlap))
        found = [each for each in warnings_of(often) if "overlap in" in each]
        assert len(found) == reported
        assert all("lm-lEE overlap in 25%" in each for each in found)


def test_flat_link_is_drawn_from_its_side(finished: tuple[NewRobot, BorderData]) -> None:
    """Seen from its side, the outline of a sheet is a line."""
    made, data = finished
    base, *others = made.meetings.units
    part = base.parts[0]
    sheet = part._replace(corners=part.corners * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.1])
    meetings = replace(made.meetings, units=(base._replace(parts=(sheet,)), *others))
    flat = replace(made, meetings=meetings)
    page = report_html(flat, data, draw(None, (flat, data)))
    assert page.count("data:image/png") >= 2


def test_each_line_starts_outside_the_buffer_and_ends_at_the_base(made: NewRobot) -> None:
    model = written(made)
    assert "guiding-front" in model.description.lines
    place = model.description.lines["guiding-front"]
    edge = model.description.bodies[0].shapes[0].size_m[0] / 2
    centre = model.description.bodies[0].shapes[0].xyz_m[0]
    end = np.add(place.start_m, place.move_m)
    beside = end[0] - centre - edge  # [m]
    assert min(abs(beside - left) for left in (0.125, 0.075, 0.025)) < 2e-3
    assert place.start_m[0] - centre - edge > 0.15  # outside the buffer
    assert scenario_of(model.description, "guiding-front").start == place.start_m
    tracked, guided = (scenario_of(model.description, n) for n in ("tracking", "guiding-lateral"))
    assert (tracked.start, tracked.move) == (guided.start, guided.move)
    assert (tracked.mode, tracked.duration) == ("tracking", 30.0)
    paper = husky_panda().description
    for name in ("guiding-lateral", "guiding-front", "tracking"):
        assert scenario_of(paper, name) == scenario_by_name(name)


def test_line_whose_start_a_quick_search_misses_is_found_by_the_complete_search(
    finished: tuple[NewRobot, BorderData], monkeypatch: pytest.MonkeyPatch
) -> None:
    made, data = finished
    solve, tries = StartSolver.solve, list[int]()

    def hurried(self: StartSolver, p_ee: Point, **options: Any) -> np.ndarray:
        tries.append(options.get("tries", 0))
        if tries[-1] == postures._FEW:
            raise UnreachableError("missed", {"out of the arm's reach": 1})
        return solve(self, p_ee, **options)

    monkeypatch.setattr(StartSolver, "solve", hurried)
    monkeypatch.setattr(postures, "_SAMPLES", 800)
    model = made.model
    found = postures.find_place(model, data.pairs, "guiding-front")
    assert isinstance(found, Place)
    assert found.nearest < postures.INNER * model.description.config.border.d_b
    assert 0 < tries.index(0) == tries.count(postures._FEW)  # complete searches are the last ones


def test_best_line_far_from_the_base_is_reported_with_the_starts_that_fail(made: NewRobot) -> None:
    model = made.model
    guide = postures._Guide(model, find_link_pairs(model, samples=500), 0.15)
    guide._obstacles["the elbow touches the floor"] += 3
    reasons = "the elbow touches the floor (3 of 3 starts)"
    assert guide.obstacles.endswith(f"the possible lines: {reasons}")
    guide._nearest = Place((0.5, 0.0, 0.4), (-0.1, 0.0, 0.0), 0.08, "")
    assert "leads to 0.080 m" in guide.obstacles
    assert guide.obstacles.endswith(reasons)


@pytest.fixture(scope="module")
def husky(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Husky with a Panda; its bodies are fitted to the URDF alone."""
    out = tmp_path_factory.mktemp("fit") / "husky_fit"
    urdf = str(ASSETS / "husky_panda" / "robot.urdf")
    request = Request(urdf=urdf, base="base_link", tip="panda_hand", out=out)
    parsed = parse(request)
    urdf = rebased_urdf(parsed, name="husky_fit", header="test")
    path = write(request.out.parent, urdf)
    bare = compiled(description(request, parsed), path)
    units = make_units(bare, parsed.arm, parsed.geometry)
    meetings = sample_meetings(bare, units, samples=2000, seed=1, d_b=0.15)
    shares: list[float] = []
    found = find_grouping(bare, meetings, d_b=0.15, on_progress=shares.append)
    assert shares[0] == 0.0  # progress is reported within the fit of many parts
    assert 0.0 < max(shares) < 1.0
    assert not found.verdict.unwatched
    return compiled(description(request, parsed, found.bodies), path)


def test_paper_robot_made_from_its_urdf_detects_its_collisions(
    husky: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the pairs of (1); the fitted bodies of l_2 and l_EE can never meet."""
    monkeypatch.setattr(grouping, "TEST_POSTURES", 2000)
    monkeypatch.setattr(grouping, "ENOUGH", 0)
    pairs = find_link_pairs(husky, samples=3000, seed=2)
    assert {pair.name for pair in pairs.mobile} == {"lm-lEE", "lm-l3"}
    assert {pair.name for pair in pairs.manipulator} == {"l1-lEE", "l1-l3"}
    row = arm_row(husky)
    assert row.numbers["colliding_poses"] > 100
    assert row.numbers["unseen_share"] <= 0.01, row


def test_upper_arm_near_the_base_keeps_its_own_body(tmp_path: Path) -> None:
    """Links 2 and 3 of a UR10 on a Husky collide with the whole wrist; the bodies detect it."""
    if not package_roots("example-robot-data"):
        pytest.skip("pip install '.[robots]'")
    request = Request(
        urdf=str(ASSETS / "bases" / "husky.urdf"),
        base="base_link",
        arm_urdf="package://example-robot-data/robots/ur_description/urdf/ur10_robot.urdf",
        tip="tool0",
        mount_xyz=(0.3, 0.0, 0.256),
        out=tmp_path / "ur10_fit",
    )
    parsed = parse(request)
    path = write(tmp_path, rebased_urdf(parsed, name="ur10_fit", header="test"))
    bare = compiled(description(request, parsed), path)
    units = make_units(bare, parsed.arm, parsed.geometry)
    meetings = sample_meetings(bare, units, samples=2000, seed=1, d_b=0.15)
    found = find_grouping(bare, meetings, d_b=0.15)
    assert set(found.verdict.unwatched) <= {"lm-l2", "l2-lEE"}
    assert found.verdict.missed < 0.01
    why = dict.fromkeys(found.verdict.unwatched, "test")
    model = compiled(description(request, parsed, found.bodies, unwatched=why), path)
    pairs = find_link_pairs(model, samples=2000, seed=2)
    assert not set(found.verdict.unwatched) & {pair.name for pair in pairs.all}
    assert {"lm-l3", "lm-lEE"} <= {pair.name for pair in pairs.all}
    with pytest.raises(ValidationError, match="there is no pair lm-l9"):
        compiled(description(request, parsed, found.bodies, unwatched={"lm-l9": "test"}), path)


def test_joint_stop_keeps_the_upper_arm_off_the_base_without_a_buffer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a low column the upper arm is always near the base, and would reach it beyond 90°."""
    low = robot([*cart(), *arm()]).replace('length="0.2"', 'length="0.06"')
    low = low.replace("0 0 0.24", "0 0 0.08").replace(
        'xyz="0 0 0.1"/><geometry', 'xyz="0 0 0.03"/><geometry'
    )
    request = Request(urdf=str(write(tmp_path, low)), base="base", tip="hand", out=tmp_path / "low")
    parsed = parse(request)
    path = write(tmp_path, rebased_urdf(parsed, name="low", header="test"))
    bare = compiled(description(request, parsed), path)
    units = make_units(bare, parsed.arm, parsed.geometry)
    meetings = sample_meetings(bare, units, samples=1500, seed=1, d_b=0.15)
    base, upper = units[0], units[3]
    assert (base.index, upper.index) in meetings.apart
    limits = with_stops(parsed.limits, bare, parsed.arm, meetings)
    k = ARM_JOINTS.index("lift")
    narrowed = [j for j in range(6) if limits.lower[j] > -2.5 or limits.upper[j] < 2.5]
    assert narrowed == [k]
    assert -2.2 < limits.lower[k] < -1.4
    assert 1.4 < limits.upper[k] < 2.2
    why = (
        "lift is limited before upper reaches base, which a pair can detect with "
        "--buffer-distance 0.13"
    )
    assert why in limits.numbers["position_upper"][1]
    # As for a UR's upper arm, 12 mm beside its foot.
    monkeypatch.setattr("app.onboarding.fit.meetings.MARGIN", 1.0)
    beside = with_stops(parsed.limits, bare, parsed.arm, meetings)
    assert limits.lower[k] < beside.lower[k] < beside.upper[k] < limits.upper[k]
    bodies = [
        fit_base(bare, meetings),
        *ArmFitter(bare, meetings).bodies([[1, 2, 3], [4], [5, 6, 7]]),
    ]
    monkeypatch.setattr(grouping, "TEST_POSTURES", 600)
    monkeypatch.setattr(grouping, "ENOUGH", 0)
    free, stopped = (
        compiled(description(request, each, bodies), path)
        for each in (parsed, replace(parsed, limits=limits))
    )
    assert detection_of(free, parsed.tree, parsed.geometry, 0.15).share > 0.1
    assert detection_of(stopped, parsed.tree, parsed.geometry, 0.15).share < 0.01
    ready = [0.0] * 6
    ready[k] = 2.4
    with pytest.raises(RobotFileError, match="--ready: upper can meet base"):
        with_stops(parsed.limits, bare, parsed.arm, meetings, ready)
    assert watching_buffer(limits, meetings, 0.15) == (0.15, "")
    # No limit may reduce a joint's range.
    monkeypatch.setattr("app.onboarding.fit.meetings.LEAST", 1.0)
    for posture in (None, ready):
        assert with_stops(parsed.limits, bare, parsed.arm, meetings, posture) == parsed.limits
    smaller, why = watching_buffer(parsed.limits, meetings, 0.15)
    assert "upper is nearer than 0.15 m to base" in why
    pair = (base.index, upper.index)
    for d_b, close in ((smaller, False), (smaller + 0.02, True)):
        assert (pair in _close_pairs(meetings.random.distances, meetings.pairs, d_b)) == close


@pytest.mark.parametrize("follows", [True, False])
def test_a_contact_with_a_head_names_the_head_and_its_joint_if_it_is_held(
    tmp_path: Path, follows: bool
) -> None:
    """The shapes of a head that follows the lift, as a HSR's, cover its travel: it is not held."""
    box = solid('<box size="0.1 0.1 0.1"/>')
    rail = 'lower="0" upper="0.4" effort="60" velocity="1"'
    mimic = '<mimic joint="rail"/>' if follows else ""
    neck = joint("neck", "prismatic", "base", "head", xyz="0.15 0 0.65", limit=rail)
    turn = joint("swing", "revolute", "carriage", "upper_arm", xyz="0.2 0 0", axis="0 1 0")
    parts = [
        *cart(),
        link("carriage", box),
        link("edge", solid('<box size="0.05 0.05 0.05"/>', xyz="0 0 0.02")),
        joint("weld", "fixed", "carriage", "edge"),
        joint("rail", "prismatic", "base", "carriage", xyz="0.15 0 0.2", limit=rail),
        link("head", box),
        neck.replace("</joint>", f"{mimic}</joint>"),
        link("eye", box),
        joint("nod", "revolute", "head", "eye", xyz="0 0 0.3", axis="0 1 0"),
        link("upper_arm", solid('<box size="0.1 0.1 0.1"/>', xyz="0.3 0 0")),
        turn,
        link("finger", box),
        joint("grip", "prismatic", "upper_arm", "finger", xyz="0.4 0 0", limit=rail),
        link("world"),
        joint("odometry", "prismatic", "world", "base", limit=rail),
    ]
    path = write(tmp_path, robot(parts))
    request = Request(urdf=str(path), base="base", tip="upper_arm", out=tmp_path / "toy")
    parsed = parse(request)
    path = write(tmp_path, rebased_urdf(parsed, name="toy", header="test"))
    bare = compiled(description(request, parsed), path)
    geometry = filled(parsed.tree, parsed.geometry, parsed.arm.joints)
    units = make_units(bare, parsed.arm, geometry)
    met = sample_meetings(bare, units, samples=400, seed=1, d_b=0.15, counted=())
    count, rule = grouping._left_out(bare, met, (), parsed.tree, geometry)
    assert count > 20
    where = "" if follows else " with neck held"
    assert rule.startswith(f"head and carriage{where} (")
    assert "%; none with rail from 0" in rule
    for name in ("base", "eye", "wheel", "nod", "axle", "edge"):  # the edge is on the carriage
        assert name not in rule
    held = held_by(parsed.tree, parsed.arm.joints)
    assert held == ({"eye": "nod"} if follows else {"head": "neck", "eye": "neck"})


def test_collision_of_a_fixed_part_counts_where_its_watched_pair_overlaps() -> None:
    """A mast belongs to l_m if no pair detects the mast's own collisions."""
    model = husky_panda()
    pairs = tuple(combinations(range(5), 2))
    touching = np.where([pair == (1, 3) for pair in pairs], -0.01, 1.0)[None]
    ready = np.array([model.description.arm.ready_position])
    rare = Postures(ready, touching, np.ones(1, dtype=bool))
    random = Postures(ready, np.ones((1, len(pairs))), np.ones(1, dtype=bool))
    meetings = Meetings((), pairs, frozenset(), frozenset(), random, rare)
    both = ("lm-lEE", "l1-lEE")
    for radius, unwatched, seen in ((0.01, (), False), (2.0, (), True), (2.0, both, False)):
        found = grouped((0.01, 0.01, 0.01, radius), unwatched)
        assert grouping._detects(model, found, meetings, 1) == seen


def grouped(radii: tuple[float, ...], unwatched: tuple[str, ...]) -> grouping.Grouping:
    """Bodies that are spheres with these radii [m]."""
    frames = ("base_link", "panda_link0", "panda_link2", "panda_hand")
    bodies = [
        FittedBody(name, frame, (), (), (Fit(sphere, 0.0, 1.0, 0.0),))
        for name, frame, sphere in zip(
            ("lm", "l1", "l2", "lEE"),
            frames,
            (Sphere(type="sphere", radius_m=radius) for radius in radii),
            strict=True,
        )
    ]
    verdict = grouping.Verdict(0.0, 0.0, {}, (), (), dict.fromkeys(unwatched, False), {}, 0.0)
    return grouping.Grouping(bodies, verdict)


def test_coarse_border_is_used_at_once_and_then_refined(
    husky: RobotModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse, asked = object(), Queue()

    def kept(_: RobotModel, sampling: SamplingConfig | None = None) -> object | None:
        return coarse if sampling == QUICK else None

    monkeypatch.setattr(cache, "kept_border_data", kept)
    monkeypatch.setattr(job.Job, "run", lambda _, *work: asked.put(work))
    assert serve._border(husky) is coarse
    assert asked.get(timeout=10) == (job.sample_border, "husky_fit")


def test_paper_robot_made_from_its_urdf_has_the_same_mass_matrix(husky: RobotModel) -> None:
    """Equal mass matrices of the rebased and the shipped URDF in random postures."""
    import pinocchio as pin

    ours = husky_panda()
    rng = np.random.default_rng(3)
    for q_m in rng.uniform(ours.q_lower, ours.q_upper, (5, 7)):
        q = ours.configuration((0.3, -0.2, 0.7), q_m)
        M, N = (np.triu(pin.crba(m.pin, m.pin.createData(), q)) for m in (husky, ours))
        np.testing.assert_allclose(M, N, atol=1e-5)


def test_contacts_with_the_base_are_watched_for_bodies_with_a_reachability() -> None:
    pairs = body_contact_pairs(husky_panda().description)
    assert {pair for pair, group in pairs.items() if group == "arm_base"} == {
        ("lm", "l3"),
        ("lm", "lEE"),
    }


def test_package_addresses_are_found_in_the_share_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = tmp_path / "some-robot" / "meshes" / "a.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_text("solid")
    monkeypatch.setattr(assets, "share_folders", lambda: [tmp_path])
    assert resolve_package_uri("package://some-robot/meshes/a.stl") == mesh
    for wrong in ("package://some-robot/../x", "package://../some-robot/meshes/a.stl"):
        with pytest.raises(assets.AssetError):
            resolve_package_uri(wrong)


def test_missing_line_error_lists_the_robots_lines() -> None:
    racecar = load_description(ASSETS / "racecar_panda" / "robot.toml")
    with pytest.raises(
        UnreachableError, match=r"no line for guiding-front.*guiding-lateral, track"
    ):
        scenario_of(racecar, "guiding-front")
    start = (1.2, 0.1, 0.3)
    scenario = scenario_of(racecar, "guiding-front", start=start)
    assert (scenario.start, scenario.move) == (start, scenario_by_name("guiding-front").move)
    assert scenario_of(racecar, "guiding-above") == scenario_by_name("guiding-above")
    bare = racecar.model_copy(update={"lines": {}})
    for name in ("guiding-lateral", "guiding-front", "tracking"):  # only for the paper's robot
        with pytest.raises(UnreachableError, match=f"no line for {name}.*it has lines for: none"):
            scenario_of(bare, name)
    assert scenario_of(bare, "guiding-front", start=start) == scenario


def test_line_without_a_scenario_is_refused_by_name() -> None:
    racecar = load_description(ASSETS / "racecar_panda" / "robot.toml")
    lines = {"guiding-latral": racecar.lines["guiding-lateral"]}
    with pytest.raises(
        DescriptionError, match=r"\[lines.guiding-latral\] .*lines are for: guiding-"
    ):
        scenario_of(racecar.model_copy(update={"lines": lines}), "guiding-above")


def test_each_missing_line_has_its_reason_and_a_shared_one_appears_once(
    made: NewRobot,
) -> None:
    lacking = {"guiding-lateral": "too short", "guiding-front": "it stands still"}
    near = made.verdict._replace(always=("lm-lEE",), near=made.verdict.near | {"lm-lEE": 0.9})
    found = {
        each.partition(": no line for guiding: ")[::2]
        for verdict in (made.verdict, near)
        for each in warnings_of(replace(made, lacking=lacking, verdict=verdict))
        if "no line" in each
    }
    both = ", ".join(lacking), "inside the buffer in most postures: lm-lEE"
    assert found == {*lacking.items(), both}


def test_warns_if_links_are_in_the_floor_or_in_the_base(made: NewRobot) -> None:
    def reported(made: NewRobot) -> list[str]:
        places = ("below the floor", "completely inside of the base")
        return [each for each in warnings_of(made) if any(place in each for place in places)]

    assert reported(made) == []
    down = np.array([0.0, 2.5, 0.5, 0.0, 0.0, 0.0])  # beside the base, below the floor
    [hand] = reported(replace(made, ready=made.ready._replace(q_m=down)))[-1:]
    assert re.match(r"links 0\.\d+ m below the floor in .*: hand; check --ready$", hand)
    arm = replace(made.request, arm_urdf="arm.urdf")
    [hand] = reported(replace(made, request=arm, ready=made.ready._replace(q_m=down)))[-1:]
    assert hand.endswith("check --mount-xyz, --mount-rpy and --ready")
    bodies = [body.model_dump() for body in made.model.description.bodies]
    size = bodies[0]["shapes"][0]["size_m"]
    bodies[0]["shapes"][0]["size_m"] = (size[0], size[1], 1.2)  # encloses the column
    column = reported(replace(made, model=written(made, bodies=bodies)))
    assert [re.findall(r"\w+", each.partition(": ")[2])[0] for each in column] == [
        "column",
        "shoulder",
    ]


def test_warns_if_meshes_have_another_scale_than_the_joints(made: NewRobot) -> None:
    def scaled(factor: float) -> NewRobot:
        geometry = dict(made.parsed.geometry)
        for name, each in geometry.items():
            hulls = [s.hull.copy().apply_scale(factor) for s in each.shapes]
            shapes = (s._replace(hull=h) for s, h in zip(each.shapes, hulls, strict=True))
            geometry[name] = each._replace(shapes=tuple(shapes))
        return replace(made, parsed=replace(made.parsed, geometry=geometry))

    assert not any("meshes are too large" in reported for reported in warnings_of(scaled(1.0)))
    assert any("meshes are too large" in reported for reported in warnings_of(scaled(8.0)))
