"""Tables, styles and the files of a figure."""

from __future__ import annotations

import csv
import io

import numpy as np
import pytest
from matplotlib.patches import Patch
from PIL import Image

from app.control.controller import CONTROLLERS
from app.onboarding.report import BODY_COLOURS
from app.onboarding.request import BOUNDS
from app.studies import style
from app.studies.paper.drawing import Drawing, stacked
from app.studies.runs import write_table


def luminance(colour: str) -> float:
    r, g, b = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return 0.2126 * r + 0.7152 * g + 0.0722 * b


def deuteranopia(colour: str) -> np.ndarray:
    """Simulated deuteranopia by Viénot, Brettel and Mollon 1999, in linear colours."""
    r, g, b = ((int(colour[i : i + 2], 16) / 255) ** 2.2 for i in (1, 3, 5))
    return np.array([0.29275 * r + 0.70725 * g, 0.29275 * r + 0.70725 * g, b])


def read(path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_reading_a_csv_returns_the_exact_table(tmp_path):
    rng = np.random.default_rng(1)
    table = {"t_s": rng.normal(size=50), "n": np.arange(50), "name": np.array(["a"] * 50)}
    write_table(tmp_path / "t.csv", table)
    rows = read(tmp_path / "t.csv")
    assert [float(row["t_s"]) for row in rows] == table["t_s"].tolist()
    assert [int(row["n"]) for row in rows] == table["n"].tolist()
    assert {row["name"] for row in rows} == {"a"}


def test_nan_is_an_empty_cell(tmp_path):
    write_table(tmp_path / "t.csv", {"n": np.arange(2), "d_m": np.array([1.5, np.nan])})
    assert [row["d_m"] for row in read(tmp_path / "t.csv")] == ["1.5", ""]


def test_columns_of_unequal_length_are_refused(tmp_path):
    with pytest.raises(ValueError, match="expected length 3 but got length 2"):
        write_table(tmp_path / "t.csv", {"a": np.arange(3), "b": np.arange(2)})


def test_stacking_preserves_every_value_with_its_case():
    table = stacked({"x": {"v": np.array([1.0, 2.0])}, "y": {"v": np.array([3.0])}}, "case")
    assert table["case"].tolist() == ["x", "x", "y"]
    assert table["v"].tolist() == [1.0, 2.0, 3.0]


def test_a_figure_is_written_as_a_picture_with_its_tables(tmp_path):
    with style.styled():
        figure = style.new_figure(4.0)
        figure.subplots().plot([0, 1], [0, 1])
    table = {"a_m": np.arange(2.0)}
    paths = Drawing(figure, {"": table, "more": table}, {}).write(tmp_path, "fig0", "t")
    assert [path.name for path in paths] == ["fig0.png", "fig0.csv", "fig0_more.csv"]
    picture = Image.open(io.BytesIO(paths[0].read_bytes()))
    assert picture.size == (round(style.WIDTH * style.DPI), round(4.0 * style.DPI))
    assert picture.width >= 1600


def test_each_body_of_a_new_robot_has_a_unique_colour():
    assert len(set(BODY_COLOURS)) == len(BODY_COLOURS) > BOUNDS["bodies"].high


@pytest.mark.parametrize("spans", [(0.7, 0.36, 0.69), (0.5, 0.5, 2.2), (2.0, 1.0, 1.0)])
def test_titles_and_legend_of_panels_with_equal_scales_stay_clear(spans):
    with style.styled():
        figure = style.new_figure(4.6)
        panels = figure.subplots(1, 3, width_ratios=[spans[0], spans[1], spans[0]])
        for ax, (x, y) in zip(panels, ((0, 2), (1, 2), (0, 1)), strict=True):
            ax.fill([0.0, 0.0, spans[x]], [0.0, spans[y], spans[y]])
            ax.set(aspect="equal", title="title", xlabel="x [m]", ylabel="y [m]")
        handles = [Patch(label=f"patch {k}") for k in range(8)]
        legend = figure.legend(handles=handles, loc="outside lower center", ncols=4)
        style.png_of(figure)
    bounds = [ax.get_tightbbox() for ax in panels]
    assert max(each.y1 for each in bounds) <= figure.bbox.y1
    assert min(each.y0 for each in bounds) >= legend.get_window_extent().y1


def test_every_controller_and_every_pair_has_a_unique_colour():
    assert set(CONTROLLERS) <= set(style.METHOD_COLOURS) == set(style.METHOD_NAMES)
    assert set(style.PAIR_COLOURS) == set(style.PAIR_NAMES)
    colours = [*style.METHOD_COLOURS.values(), *style.PAIR_COLOURS.values()]
    assert len(set(colours)) == len(colours)


@pytest.mark.parametrize("colours", [style.METHOD_COLOURS, style.PAIR_COLOURS])
def test_colours_are_distinct_with_colour_blindness(colours):
    seen = [deuteranopia(colour) for colour in colours.values()]
    gaps = [np.abs(a - b).max() for i, a in enumerate(seen) for b in seen[:i]]
    assert min(gaps) > 0.05
    assert all(luminance(colour) < 0.8 for colour in colours.values())  # on white


def test_the_style_ends_with_its_block():
    import matplotlib

    before = dict(matplotlib.rcParams)
    with style.styled():
        assert matplotlib.rcParams["axes.grid"] is True
    assert dict(matplotlib.rcParams) == before
