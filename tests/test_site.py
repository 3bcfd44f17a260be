"""The static site: replays, borders and the page with links to them."""

from __future__ import annotations

from pathlib import Path

import pytest

from app.dashboard.export.browser import new_context
from app.errors import DbbError
from app.simulation.scenarios import scenario_of
from tests.robots import husky_panda
from tools import site

pytestmark = [pytest.mark.slow, pytest.mark.browser]

_BORDER = "() => dbbPage.ready() && dbbPage.has('/robot/border_lm-lEE')"


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """The folder of a static web site with replays of a short run with two controllers."""
    out = tmp_path_factory.mktemp("site")
    run = scenario_of(husky_panda().description, "guiding-front").changed(duration=0.5)
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(site, "DISTANCES", (0.1, 0.2))
        site.make_site(out, [run], ["dbb", "none"], ["score"])
    return out


def test_start_page_links_to_replays_and_borders(browser, made):
    page, errors = browser.new_page(), []
    page.on("pageerror", lambda error: errors.append(str(error)))
    page.goto((made / "index.html").as_uri())
    links = page.locator("td a").evaluate_all("links => links.map(a => a.getAttribute('href'))")
    assert links == ["replays/guiding-front-dbb.html", "replays/guiding-front-none.html"]
    assert all((made / link).exists() for link in links)
    assert [o.get_attribute("value") for o in page.locator("option").all()] == [
        "border/lm-lEE-score.html",
        "border/lm-l3-score.html",
    ]
    assert page.locator("option").first.inner_text() == "end-effector – base, score"
    assert page.locator("td small").nth(1).inner_text().endswith(" mm")
    page.close()
    assert errors == []


def test_border_page_shows_the_border_and_the_buffer_distance(browser, made):
    page = new_context(browser, (640, 480)).new_page()
    page.goto((made / "border/lm-lEE-score.html").as_uri())
    page.wait_for_function(_BORDER, timeout=60_000)
    page.wait_for_function("() => '/d_b' in dbbPage.viewer().nodePoseData")


def test_a_page_that_is_too_large_is_refused(made, monkeypatch):
    monkeypatch.setattr(site, "LARGEST", 10.0)
    with pytest.raises(DbbError, match="a page may have"):
        site._write(made / "large.html", "x" * 11)
    assert not (made / "large.html").exists()
