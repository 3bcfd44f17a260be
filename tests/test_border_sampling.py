"""Sampling of P_i: the flood, the voxels and the processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

from app.border.dbb import quantise_points
from app.border.sampling import AROUND, PairReader, SamplingConfig, Voxels, sample_clouds
from app.errors import DescriptionError
from app.jobs.pool import Workers
from app.robot.link_pairs import Pair
from tests.finite_differences import jacobian
from tests.robots import husky_panda

PAIRS = (Pair("lm", "lEE"), Pair("lm", "l3"))
COARSE = SamplingConfig(
    seed=3, cloud_samples=4000, voxel_plan=0.04, voxel_height=0.04, sectors=4, retries=2
)


@pytest.fixture(scope="module")
def clouds():
    return sample_clouds(husky_panda(), PAIRS, COARSE, progress=False, processes=1)


def voxels(sectors: int = 16) -> Voxels:
    return Voxels(
        np.array([-0.495, -0.345, 0.0]),
        np.array([0.495, 0.345, 0.38]),
        reach=0.32,
        size=np.array([0.008, 0.008, 0.005]),
        sectors=sectors,
    )


@pytest.mark.slow
def test_the_clouds_do_not_depend_on_the_number_of_processes(clouds):
    again = sample_clouds(husky_panda(), PAIRS, COARSE, progress=False, processes=2)
    assert clouds.keys() == again.keys() == {"lm-lEE", "lm-l3"}
    for name, cloud in clouds.items():
        np.testing.assert_array_equal(cloud.points, again[name].points)
        np.testing.assert_array_equal(cloud.distances, again[name].distances)


def test_another_seed_gives_other_points(clouds):
    other = COARSE.model_copy(update={"seed": 4})
    again = sample_clouds(husky_panda(), PAIRS, other, progress=False, processes=1)
    assert not np.array_equal(clouds["lm-lEE"].points, again["lm-lEE"].points)


def test_each_voxel_has_one_point_with_its_distance_above_the_floor(clouds):
    for cloud in clouds.values():
        cells = cloud.points // 400  # 40 mm; the grid starts at multiples of it
        assert len(np.unique(cells, axis=0)) == len(cloud)
        p = cloud.points_m
        outside = np.maximum(np.abs(p - [0, 0, 0.1902]) - [0.495, 0.345, 0.19015], 0)
        measured = np.linalg.norm(outside, axis=1)
        np.testing.assert_allclose(cloud.d_m, measured, atol=5.1e-6)
        assert (measured > 0.0299).all()
        assert (measured < 0.3201).all()
        assert (p[:, 2] >= 0).all()


def test_the_flood_reaches_voxels_that_random_sampling_alone_leaves_empty(clouds):
    """40,000 random postures fill less than half as many voxels beside the base."""
    reader = PairReader(husky_panda(), PAIRS[0])
    rng = np.random.default_rng(9)
    model = husky_panda()
    beside = clouds["lm-lEE"].points[:, 2] < 3800
    flooded = len(clouds["lm-lEE"].points[beside])
    seen = reader.witnesses(rng.uniform(model.q_lower, model.q_upper, (40_000, model.n_m)))
    inside = (seen.d > 0.03) & (seen.d < 0.32) & (seen.p_b[:, 2] < 0.38) & (seen.p_b[:, 2] >= 0)
    sampled = len(np.unique(quantise_points(seen.p_b[inside]) // 400, axis=0))
    assert sampled > 10
    assert flooded > 2 * sampled


def test_the_sectors_leave_no_seam_in_the_cloud():
    """One sector and eight sectors fill the same voxels, except for less than 3 %."""
    counts = []
    for sectors in (1, 8):
        config = COARSE.model_copy(update={"sectors": sectors})
        cloud = sample_clouds(husky_panda(), PAIRS[:1], config, progress=False, processes=1)
        counts.append({tuple(cell) for cell in cloud["lm-lEE"].points // 400})
    assert len(counts[0] ^ counts[1]) < 0.03 * len(counts[0])


def test_the_jacobian_is_that_of_the_material_point():
    """The reference follows a point fixed in the last body by forward kinematics alone."""
    import pinocchio as pin

    model = husky_panda()
    reader = PairReader(model, PAIRS[0])
    joint, data = model.body_joints["lEE"], model.pin.createData()
    rng = np.random.default_rng(5)
    for q_m in rng.uniform(model.q_lower, model.q_upper, (10, 7)):
        p = reader.witnesses(q_m[None]).p_b[0]
        pin.forwardKinematics(model.pin, data, model.configuration((0, 0, 0), q_m))
        local = data.oMi[joint].actInv(p)

        def at(step, q_m=q_m, local=local):
            pin.forwardKinematics(model.pin, data, model.configuration((0, 0, 0), q_m + step))
            return data.oMi[joint].act(local)

        J = reader.jacobians(q_m[None], p[None])[0]
        np.testing.assert_allclose(J, jacobian(at, 7), atol=1e-8)


def test_a_voxels_centre_lies_in_it_and_its_neighbours_share_a_face():
    grid = voxels()
    p = quantise_points(
        np.random.default_rng(6).uniform([-0.8, -0.6, 0], [0.8, 0.6, 0.7], (500, 3))
    )
    cells = grid.cells(p)
    np.testing.assert_array_equal(grid.cells(quantise_points(grid.centres(cells))), cells)
    assert (np.abs(grid.centres(cells) - p * 1e-4) <= np.array([0.0041, 0.0041, 0.0026])).all()
    assert (np.abs(AROUND).sum(axis=1) == [0, 1, 1, 1, 1, 1, 1]).all()
    assert len(np.unique(AROUND, axis=0)) == 7
    keys = grid.keys(cells)
    assert (keys >= 0).all()
    assert len(np.unique(keys)) == len(np.unique(cells, axis=0))
    assert grid.keys(np.array([[-1, 0, 0]]))[0] == -1
    assert grid.keys(grid.shape[None])[0] == -1


def test_every_voxel_is_in_one_sector_with_no_seam_on_the_wheel_axis():
    grid = voxels()
    masks = grid.sectors(np.arange(grid.count)) == np.arange(16)[:, None]
    assert (masks.sum(axis=0) == 1).all()
    on_axis = quantise_points(np.array([[x, 0.5, 0.1] for x in (-0.05, 0.0, 0.05)]))
    assert len(set(grid.sectors(grid.keys(grid.cells(on_axis))))) == 1


def test_a_base_too_large_for_the_stored_integers_is_refused():
    with pytest.raises(DescriptionError, match="extends more than"):
        Voxels(np.full(3, -4.0), np.full(3, 4.0), reach=0.32, size=np.full(3, 0.01), sectors=1)


class Made:
    """Counts its instances."""

    count = 0

    def __init__(self) -> None:
        Made.count += 1


def test_one_process_makes_its_context_once_for_all_work():
    with Workers(Made, processes=1) as workers:
        first, second = (list(workers.map(lambda made, _: made, [1, 2])) for _ in range(2))
    assert len({*first, *second}) == Made.count == 1


CTRL_C = """
from app.jobs.pool import Workers
from tests.jobs import say_and_wait
with Workers(int, processes=2) as workers:
    list(workers.map(say_and_wait, range(8)))
"""


def test_ctrl_c_ends_the_sampling_and_leaves_no_process(tmp_path):
    script = tmp_path / "script.py"
    script.write_text(CTRL_C)
    process = subprocess.Popen(
        [sys.executable, str(script)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.getcwd()},
        start_new_session=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith("started")
    start = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=20)
    assert time.monotonic() - start < 10  # [s]; the jobs would take 60 s
    assert process.returncode != 0
    assert errors.count("KeyboardInterrupt") == 1  # from the parent only
    assert _gone(process.pid)


def _gone(group: int) -> bool:
    """Whether a group of processes ends within 5 s."""
    for _ in range(50):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.1)
    return False
