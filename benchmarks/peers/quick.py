"""The duration of one step of pink on this machine, as a reference for our own step."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.robot.model import RobotModel
from benchmarks.peers.environments import PeerError, ensure_environment
from benchmarks.peers.names import PEERS
from benchmarks.peers.paths import ee_paths
from benchmarks.peers.plan import BASE_WEIGHTS, write_plan
from benchmarks.peers.running import run_driver

_PATH = "side"


class PinkStep(NamedTuple):
    """Time of a step of pink with barriers for the five pairs, along the path from the side.

    Attributes:
        p50_us: [µs] median, or None if pink could not be measured.
        p99_us: [µs] 99th percentile, or None.
        reason: Reason of a missing measurement, or an empty string.
    """

    p50_us: float | None
    p99_us: float | None
    reason: str = ""


def pink_step(model: RobotModel, data: BorderData, environments: Path) -> PinkStep:
    """Measure the step in a separate process: 3,000 steps, about three seconds.

    Args:
        model: The robot.
        data: Its pairs.
        environments: Folder of the libraries' environments; a missing one of pink is created, which
            needs a package index.
    """
    pink = PEERS["pink"]
    try:
        python = ensure_environment(environments / "pink", pink.requirements)
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name) / "plan"
            folder.mkdir()
            paths = ee_paths(model, data, [_PATH])
            write_plan(folder, model, data, paths, BASE_WEIGHTS[:1])
            done = run_driver("pink", pink, python, folder, Path(name) / "out")
    except PeerError as error:
        return PinkStep(None, None, str(error))
    if not done.motions:
        return PinkStep(None, None, "; ".join(done.errors.values()) or "pink wrote nothing")
    (motion,) = done.motions.values()
    p50, p99 = 1e6 * np.percentile(motion.step_s, [50, 99])
    return PinkStep(float(p50), float(p99))
