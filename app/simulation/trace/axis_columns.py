"""Names in files of what happens along a base's velocity axes."""

from __future__ import annotations

from app.robot.bases.kind import Axis


def axis_name(axis: Axis) -> str:
    """The axis in plain letters: v, vx, vy or w."""
    return axis.symbol.replace("_", "").replace("ω", "w")


def velocity_column(axis: Axis) -> str:
    """The velocity along the axis with its unit, as in vx_mps or w_radps."""
    return f"{axis_name(axis)}_{'radps' if axis.angular else 'mps'}"


def acceleration_column(axis: Axis) -> str:
    """Its derivative with the unit, as in ax_mps2 or aw_radps2."""
    if axis.angular:
        return f"a{axis_name(axis)}_radps2"
    return f"a{axis_name(axis).removeprefix('v')}_mps2"
