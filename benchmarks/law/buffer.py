"""The d_b required for an approach speed, from the front and from the side."""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from app.config import Config
from app.control.buffer_need import RESERVE, Approach, buffer_need
from benchmarks.law.options import Options
from benchmarks.law.report import Report
from benchmarks.law.robot import load

_SPEEDS = 0.05, 0.10, 0.15, 0.20, 0.30, 0.40  # [m/s]
_DELAYS = 0.0, 0.2  # [s] of the base's commands
_PLACES = {
    "front": ((1.0, 0.0, 0.0), (0.65, 0.0, 0.40)),
    "side": ((0.0, 1.0, 0.0), (0.35, 0.45, 0.40)),
}
"""Normal from the base to the arm, and the arm's closest point [m], in the base's frame."""


def buffer(options: Options) -> Report:
    """Compute the required d_b, without a simulation.

    Args:
        options: See `Options`.
    """
    base = load(options.robot).model.description.base
    rows = []
    for v, place, delay in product(_SPEEDS, _PLACES, _DELAYS):
        config, (n, p_b) = Config().replace("disturbance.base_delay", delay), _PLACES[place]
        need = buffer_need(Approach(v, np.array(n), np.array(p_b)), base, config)
        needed = need if math.isfinite(need) else None
        rows.append({"v_mps": v, "place": place, "delay_s": delay, "needed_d_b_m": needed})
    return Report("buffer", rows, {"reserve_m": RESERVE})
