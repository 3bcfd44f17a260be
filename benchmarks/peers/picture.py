"""The table as a picture: times of a step, and the result of each peer on each path."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle

from app.studies.style import INK, METHOD_COLOURS, SOFT, TARGET, new_figure, png_of, styled
from benchmarks.peers.names import PEERS
from benchmarks.peers.plan import D_MIN
from benchmarks.peers.rows import Row
from benchmarks.peers.table import PATH_TITLES, weight_title

_LIBRARY = "#616E7C"
_ERRORS = LogNorm(1e-4, 1e-1)  # [m] ends of the scale of colours
_NEARER = 0.9  # [-] share of d_min; smaller distances are marked
_HATCH = "////"


def draw(rows: Sequence[Row]) -> bytes:
    """The picture as a PNG.

    Args:
        rows: Rows of `rows.rows_of`; at least one.
    """
    names = list(dict.fromkeys(row["peer"] for row in rows))
    paths = list(dict.fromkeys(row["path"] for row in rows))
    weights = list(dict.fromkeys(row["base_weight"] for row in rows))
    with styled():
        figure = new_figure(1.9 + 0.62 * len(names), 4.4 + 0.82 * len(paths) * len(weights))
        widths = [3.2] + [0.9 * len(paths)] * len(weights)
        panels = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths)[0]
        _times(panels[0], names, rows)
        for axes, weight in zip(panels[1:], weights, strict=True):
            here = {(r["peer"], r["path"]): r for r in rows if r["base_weight"] == weight}
            _cells(axes, names, paths, here)
            title = weight_title(weight).replace("`", "").replace("; ", ";\n")
            axes.set_title(title, fontsize=11)
        figure.suptitle(
            "Same robot and paths: final error of the end-effector, smallest distance of the arm\n"
            "Libraries: velocities every 5 ms, no plant. Our own controllers: torques every 1 ms, "
            "with physics.",
            x=0.01,
            ha="left",
            fontsize=12,
        )
        figure.legend(handles=_key(), loc="outside lower center", ncols=5, fontsize=9.5)
        return png_of(figure)


def _times(axes: Axes, names: Sequence[str], rows: Sequence[Row]) -> None:
    """Draw medians over runs: a step's median as a bar, and its 99th percentile as a mark."""
    for y, name in enumerate(names):
        good = [row for row in rows if row["peer"] == name and row["status"] == "ok"]
        if not good:
            axes.annotate(
                "no figures",
                (0.02, y),
                xycoords=axes.get_yaxis_transform(),
                va="center",
                color=SOFT,
                fontsize=9,
            )
            continue
        p50, p99 = (np.median([r[key] for r in good]) for key in ("step_p50_us", "step_p99_us"))
        colour = METHOD_COLOURS.get(name, _LIBRARY)
        axes.barh(y, p50 / 1000, height=0.55, color=colour)
        axes.plot(p99 / 1000, y, marker="|", markersize=12, markeredgewidth=2, color=INK)
        axes.annotate(
            f"{p50 / 1000:.2g} / {p99 / 1000:.2g} ms",
            (p99 / 1000, y),
            xytext=(6, 0),
            textcoords="offset points",
            va="center",
            fontsize=9,
        )
    axes.set_xscale("log")
    axes.set_xlim(0.005, 60.0)
    axes.set_xticks([0.01, 0.1, 1.0, 10.0], ["0.01", "0.1", "1", "10"])
    axes.set_yticks(range(len(names)), [PEERS[name].title for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("one step [ms]")
    axes.set_title("Step: median / 99th percentile", fontsize=11)


def _cells(
    axes: Axes, names: Sequence[str], paths: Sequence[str], rows: dict[tuple[str, str], Row]
) -> None:
    """Draw a cell for each library and path.

    Its colour and its upper number are the final error; its lower number is the smallest distance.
    """
    for y, name in enumerate(names):
        for x, path in enumerate(paths):
            row = rows.get((name, path))
            if row is None or row["status"] != "ok":
                _closed(axes, x, y, "" if row is None else row["status"])
            else:
                _cell(axes, x, y, row)
    axes.set_xlim(-0.5, len(paths) - 0.5)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xticks(range(len(paths)), [PATH_TITLES.get(path, path) for path in paths], fontsize=9)
    axes.set_yticks([])
    axes.grid(visible=False)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.tick_params(length=0)


def _cell(axes: Axes, x: int, y: int, row: Row) -> None:
    error, near = row["error_final_m"], row["clearance_m"]
    share = float(np.clip(_ERRORS(max(error, 1e-12)), 0.0, 1.0))
    colour = colormaps["Blues"](0.05 + 0.8 * share)
    axes.add_patch(Rectangle((x - 0.47, y - 0.44), 0.94, 0.88, facecolor=colour))
    ink = "white" if share > 0.6 else INK
    text = f"{1000 * error:.0f} mm" if error >= 0.0095 else f"{1000 * error:.1f} mm"
    axes.annotate(
        text, (x, y - 0.13), ha="center", va="center", fontsize=9, color=ink, weight="bold"
    )
    too_near = near < _NEARER * D_MIN
    axes.annotate(
        f"{1000 * near:.0f} mm", (x, y + 0.2), ha="center", va="center", fontsize=8, color=ink
    )
    if too_near:
        axes.add_patch(
            Rectangle((x - 0.45, y - 0.42), 0.9, 0.84, fill=False, edgecolor=TARGET, linewidth=1.6)
        )


def _closed(axes: Axes, x: int, y: int, text: str) -> None:
    """Draw a run without results: a hatched cell at column x and row y, with a text."""
    axes.add_patch(
        Rectangle(
            (x - 0.47, y - 0.44),
            0.94,
            0.88,
            facecolor="white",
            edgecolor=SOFT,
            hatch=_HATCH,
            linewidth=0.6,
        )
    )
    axes.annotate(
        text,
        (x, y),
        ha="center",
        va="center",
        fontsize=8.5,
        color=INK,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1.5},
    )


def _key() -> list[Patch | Line2D]:
    near, far = (colormaps["Blues"](0.05 + 0.8 * share) for share in (0.0, 1.0))
    return [
        Patch(facecolor=near, label="ends within 0.1 mm"),
        Patch(facecolor=far, label="ends 100 mm off"),
        Patch(facecolor="white", edgecolor=TARGET, label=f"nearer than {900 * D_MIN:.0f} mm"),
        Patch(facecolor="white", edgecolor=SOFT, hatch=_HATCH, label="missing or failed"),
        Line2D([], [], linestyle="none", label="bold: final error; below: smallest distance"),
    ]
