"""`index.html` refers to no other file and shows all its input."""

from __future__ import annotations

import re
from base64 import b64decode
from html.parser import HTMLParser
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from app.studies import style
from app.studies.page import Part, label
from app.studies.paper.drawing import Drawing
from app.studies.paper.report import figure_part, paper_page

PNG = bytes(range(256))
LIMIT = {"value": 0.05, "unit": "m", "source": "Figure 10"}


def draw() -> None:
    """The paper says <this>."""


@pytest.fixture
def section(tmp_path: Path):
    """Makes a part of the page with a figure; `changes` replace fields of its drawing."""

    def make(name: str = "fig1", **changes) -> Part:
        drawing = Drawing(Figure(), {}, {"d_min_m": 0.125}, ["so"])
        figure = style.picture(name, "Figure 1: a & b")(draw)
        picture = tmp_path / f"{name}.png"
        picture.write_bytes(PNG)
        return figure_part(figure, drawing._replace(**changes), [picture])

    return make


def claim(holds: bool) -> dict[str, object]:
    return {
        "section": "4.2",
        "paper": "it <works>",
        "measured": "0.1 m",
        "holds": holds,
        "limits": [LIMIT],
    }


class Reader(HTMLParser):
    """Collects addresses, and checks that every tag is closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.open: list[str] = []
        self.text = ""
        self.feed(text)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.addresses += [value or "" for key, value in attrs if key in ("src", "href")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_the_page_refers_to_nothing_outside_itself(section):
    text = paper_page([section(), section(name="fig2")], [claim(True)], "seed 0")
    reader = Reader(text)
    assert len(reader.addresses) == 5
    assert all(a.startswith(("data:image/png;base64,", "#")) for a in reader.addresses)
    assert not re.search(r"https?:|//|@import|url\(|<script|<link", text.replace("/9", ""))


def test_the_picture_is_embedded_exactly(section):
    (address,) = re.findall(r"base64,([^\"]+)", paper_page([section()], [], ""))
    assert b64decode(address) == PNG


def test_the_papers_statement_precedes_the_measurement(section):
    text = Reader(paper_page([section()], [], "")).text
    assert text.index("says <this>") < text.index("d min [m]") < text.index("0.125")


def test_markup_in_texts_is_escaped(section):
    text = paper_page([section()], [claim(True)], "a < b")
    assert "<this>" not in text
    assert "<works>" not in text
    assert "a &lt; b" in text


def test_links_to_figures_of_one_section_differ(section):
    titles = "§4.3: density of the border", "§4.3: a continuous border"
    parts = [section(f"part{k}")._replace(title=title) for k, title in enumerate(titles)]
    links = paper_page(parts, [], "about").partition("<nav>")[2].partition("</nav>")[0]
    assert ">density of the border<" in links
    assert ">a continuous border<" in links


def test_figures_precede_the_claims(section):
    text = Reader(paper_page([section()], [claim(True)], "")).text
    assert text.index("says <this>") < text.index("it <works>")


def test_claims_are_counted_and_failed_claims_are_marked(section):
    text = Reader(paper_page([section()], [claim(True), claim(False), claim(True)], "")).text
    assert "2 of 3 claims hold" in text
    assert text.count("✓ holds") == 2
    assert text.count("✗ does not") == 1
    assert text.count("Figure 10") == 3


def test_cases_are_side_by_side_and_missing_values_are_marked(section):
    measured = {"dbb": {"d_m": 0.1, "jump": {"linear_mps2": 0.25}}, "none": {"d_m": None}}
    text = Reader(paper_page([section(measured=measured)], [], "")).text
    assert "dbb" in text
    assert "jump linear [m/s²]" in text
    assert text.count("not measured") == 2


@pytest.mark.parametrize(
    ("key", "text"),
    [
        ("d_min_m", "d min [m]"),
        ("base_yaw_rad", "Rotation of the base from start to end [rad]"),
        ("linear_mps2", "linear [m/s²]"),
        ("angular_radps2", "angular [rad/s²]"),
        ("score_max_m4prad4", "score max [m⁴/rad⁴]"),
        ("A_per_m2", "A [1/m²]"),
        ("torque_jump_max_nm", "Largest change of a joint's torque or force in one step [N m]"),
        ("find_p50_us", "find p50 [µs]"),
        ("contacts", "Steps in which the arm touched the base"),
    ],
)
def test_a_keys_ending_becomes_its_unit(key, text):
    assert label(key) == text
