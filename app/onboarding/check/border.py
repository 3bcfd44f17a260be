"""Check of the border: it has points at every height that the arm reaches beside the base."""

from __future__ import annotations

import numpy as np

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.config import Config
from app.onboarding.check.checks import Row
from app.robot.model import RobotModel

_LAYER = 0.05  # [m]
_MANY = 500  # [-] points nearer than the border by which a layer counts as reached
_FEW = 10  # [-] points of the border in a layer that is not empty


def border_row(model: RobotModel, data: BorderData) -> Row:
    """Each pair of L_m has a border, without a gap between the heights that it has.

    At the lowest and highest heights that the arm reaches it may not get as far out as the border:
    there the exact offset of l_m stands in, which is told.
    """
    if not data.clouds:
        return Row("border", "warned", "no part of the arm can meet the base: there is none", {})
    border, top = Config().border, float(MobileBody(model).upper[2])
    empty, ends, numbers = [], [], {}
    for name, cloud in data.clouds.items():
        made = construct_dbb(cloud, border.d_b, border.eps)
        numbers[f"points_{name}"] = float(len(made))
        if not len(made):
            empty.append(f"{name} has no point at all")
            continue
        inside = cloud.points_m[cloud.d_m < border.d_b - border.eps][:, 2]
        lowest, highest = float(made.heights[0]), float(made.heights[-1])
        for z in np.arange(_LAYER / 2, top, _LAYER).round(3).tolist():
            reached = np.count_nonzero(np.abs(inside - z) < _LAYER / 2) >= _MANY
            if reached and len(made.same_height(z, _LAYER / 2)) < _FEW:
                between = lowest < z - _LAYER and z + _LAYER < highest
                (empty if between else ends).append(f"{name} at z = {z:.2f} m")
    if empty:
        outcome = "failed" if any("at all" in each for each in empty) else "warned"
        return Row("border", outcome, f"no points of {'; '.join(empty)}", numbers)
    text = "at every height that the arm reaches beside the base: "
    text += ", ".join(f"{n.removeprefix('points_')} {c:,.0f} points" for n, c in numbers.items())
    if ends:
        text += f"; at the end of its reach the exact offset stands in: {', '.join(ends)}"
    return Row("border", "passed", text, numbers)
