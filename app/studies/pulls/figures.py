"""The pictures of a study's report."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from app.studies.pulls.case import failed, met_base, met_itself
from app.studies.pulls.envelope import FORCE, Envelope
from app.studies.runs import Row
from app.studies.style import INK, SOFT, TARGET, new_figure, picture, pictures_in

_CLEARANCES = 0.0, 0.15  # [m] ends of the colour scale
_LARGEST = 0.3  # [m] end of the axes of distance
_ERRORS = 1e-5, 1.0  # [m] ends of the axes of errors
_SHADE = "#DCEBF5"
_INSIDE, _OUTSIDE = "#0072B2", "#E69F00"
_BEYOND = 1.15  # [-] end of the force axis relative to the largest force


@picture("envelope", "Envelope of safety")
def draw_envelope(rows: Sequence[Row], envelope: Envelope, _: float) -> Figure:
    """Each point is a case; cases that stopped with an error are missing. The blue area is the
    envelope that is fitted to these cases. Its force is at most 0.9 times the smallest force of the
    cases that failed or in which the arm came nearer to the base than 10 mm.
    """
    figure = new_figure(4.6)
    axes = figure.subplots()
    known = [row for row in rows if row.get(FORCE) is not None]
    low, high = envelope.speed
    axes.fill_between((low, high), envelope.force, color=_SHADE, zorder=0)
    axes.hlines(envelope.force, low, high, color=INK, linewidth=2, zorder=3)
    good = [row for row in known if not failed(row)]
    points = axes.scatter(
        [row["speed_mps"] for row in good],
        [row[FORCE] for row in good],
        c=[row["min_clearance_m"] for row in good],
        cmap="viridis",
        norm=Normalize(*_CLEARANCES),
        s=16,
        linewidths=0.4,
        edgecolors="white",
        zorder=4,
    )
    figure.colorbar(
        points, ax=axes, extend="max", pad=0.01, label="smallest distance, arm to base [m]"
    )
    for name, (rule, style) in _MARKS.items():
        bad = [row for row in known if failed(row) and rule(row)]
        places = [row["speed_mps"] for row in bad], [row[FORCE] for row in bad]
        axes.scatter(*places, zorder=5, label=name, **style)
    figure.legend(loc="outside upper center", ncols=len(_MARKS))
    axes.set_xlabel("speed of the person's hand [m/s]")
    axes.set_xlim(low - 0.02, high + 0.02)
    axes.set_ylabel("largest force before a distance of 10 mm [N]")
    axes.set_ylim(0.0, _BEYOND * max([row[FORCE] for row in known] + [envelope.force, 1.0]))
    return figure


@picture("clearance", "Smallest distance between arm and base")
def draw_clearance(rows: Sequence[Row], envelope: Envelope, d_b: float) -> Figure:
    """The smallest true distance between the convex bodies of arm and base in each run. The red
    line is contact, the grey line is d_b. Left: number of cases inside and outside the envelope
    that is fitted to them. Right: each case, by the direction of its start; failed cases are red.
    """
    figure = new_figure(4.2)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    known = [row for row in rows if row.get("min_clearance_m") is not None]
    low = min([0.0] + [row["min_clearance_m"] for row in known])
    bins = np.arange(np.floor(low / 0.01) * 0.01, _LARGEST + 0.01, 0.01)
    inside = [row["min_clearance_m"] for row in known if envelope.holds(row)]
    outside = [row["min_clearance_m"] for row in known if not envelope.holds(row)]
    left.hist(
        [np.clip(part, bins[0], bins[-1]) for part in (inside, outside)],
        bins=list(bins),
        stacked=True,
        color=[_INSIDE, _OUTSIDE],
        label=[f"inside, {len(inside)}", f"outside, {len(outside)}"],
    )
    left.axvline(0.0, color=TARGET, linewidth=1.2)
    left.axvline(d_b, color=SOFT, linewidth=1.2)
    left.set_xlabel("smallest distance between arm and base [m]; the last bar has no upper limit")
    left.set_ylabel("cases")
    left.legend(title="envelope", loc="upper center")
    _by_kind(right, known, "min_clearance_m")
    right.axvline(0.0, color=TARGET, linewidth=1.2)
    right.set_xlim(low - 0.01, _LARGEST)
    right.set_xlabel("smallest distance [m]")
    return figure


@picture("errors", "Final error of the end-effector")
def draw_errors(rows: Sequence[Row], *_: object) -> Figure:
    """The distance of the end-effector from its target at the end of each run. If the base cannot
    move away in the direction of a pull, such as down onto the base, the arm resists the pull: the
    end-effector then intentionally ends far from the target.
    """
    figure = new_figure(3.8)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    known = [row for row in rows if row.get("ee_error_final_m") is not None]
    values = np.clip([row["ee_error_final_m"] for row in known], _ERRORS[0], None)
    left.hist(values, bins=list(np.geomspace(*_ERRORS, 41)), color=_INSIDE)
    left.set_xscale("log")
    left.set_xlabel("final distance of the end-effector from its target [m]")
    left.set_ylabel("cases")
    _by_kind(right, known, "ee_error_final_m", _ERRORS[0])
    right.set_xscale("log")
    right.set_xlim(*_ERRORS)
    right.set_xlabel("final distance [m]")
    return figure


_MARKS: dict[str, tuple[Callable[[Row], bool], dict]] = {
    "arm met base": (met_base, {"marker": "x", "s": 44, "c": TARGET}),
    "arm met itself": (
        lambda row: met_itself(row) and not met_base(row),
        {"marker": "+", "s": 54, "c": "#882E72"},
    ),
    "fallback command, NaN or error": (
        lambda row: not met_base(row) and not met_itself(row),
        {"marker": "^", "s": 34, "c": "#D55E00"},
    ),
}


def _by_kind(axes: Axes, rows: Sequence[Row], column: str, low: float = -np.inf) -> None:
    """Draw the cases of each kind as a row of points, which are spread vertically.

    A value below `low` is drawn at `low`.
    """
    kinds = sorted({row["kind"] for row in rows}, reverse=True)
    for y, kind in enumerate(kinds):
        here = [row for row in rows if row["kind"] == kind]
        spread = y + 0.5 * (np.arange(len(here)) % 7 - 3) / 6
        colours = [TARGET if failed(row) else _INSIDE for row in here]
        values = np.maximum([row[column] for row in here], low)
        axes.scatter(values, spread, c=colours, s=10, linewidths=0)
    axes.set_yticks(range(len(kinds)), kinds, fontsize=9)
    axes.grid(visible=False, axis="y")


PICTURES = pictures_in(globals())
"""Pictures of the report; `draw` takes the rows, the fitted envelope, and the robot's d_b [m]."""
