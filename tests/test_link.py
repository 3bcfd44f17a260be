"""Links: the address restores the page, and a wrong one changes nothing."""

import json
import urllib.error
import urllib.request
from html import unescape
from urllib.parse import urlsplit

import numpy as np
import pytest
from app.dashboard.panels.share import Link, camera_text, read_link

from app.config import Config
from app.dashboard.viser_compat import close_server, open_server
from app.errors import DbbError
from app.simulation.case import RunCase, RunSpec
from app.simulation.loop.commands import Choose, Configure, Play
from app.simulation.scenarios import SCENARIOS
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard

LINK = "scenario=guiding-front&controller=barrier&border.d_b=0.2&look=top&at=4.5"


def test_a_link_is_read_as_it_is_written():
    link = Link.read(LINK + "&border.kind=points&robot=husky_panda")
    assert Link.read(link.query()) == link
    assert link.changes({})["border.d_b"] == 0.2
    assert link.changes({})["border.kind"] == "points"
    assert (link.scenario, link.controller, link.at) == ("guiding-front", "barrier", 4.5)


def test_a_scenario_has_the_links_parameters_alone_and_without_one_the_others_stay():
    tuned = {"force.f_max": 100.0}
    assert Link.read("scenario=tracking").changes(tuned) == {}
    assert Link.read("border.d_b=0.1").changes(tuned) == tuned | {"border.d_b": 0.1}


def test_changed_parameters_make_the_configuration_again():
    config = Config().replace("border.d_b", 0.2).replace("border.kind", "points")
    link = Link(parameters=tuple(config.changes(Config()).items()))
    assert Config().changed(link.changes({})) == config


def test_a_camera_comes_back_to_the_centimetre():
    eye, target = np.array([1.234, -5.0, 2.0]), np.array([0.0, 0.5, 0.25])
    found = Link.read(f"look={camera_text(eye, target)}").camera()
    assert found is not None
    np.testing.assert_allclose(found, (eye, target), atol=0.0051)


@pytest.mark.parametrize(
    ("query", "named"),
    [
        ("scenario=guiding-fornt", "did you mean 'guiding-front'"),
        ("controller=db", "did you mean 'dbb'"),
        ("robot=huskypanda", "did you mean 'husky_panda'"),
        ("border.db=0.2", "did you mean 'border.d_b'"),
        ("border.d_b=9", "0.06 to 0.3 m"),
        ("border.d_b=abc", "'abc' is not a number"),
        ("border.d_b=nan", "not a number"),
        ("border.kind=line", "surface or points"),
        ("look=above", "look"),
        ("look=1,2,3,4,5,x", "not a number"),
        ("look=1,2,3,1,2,0", "exactly above or below"),
        ("look=1,2,3,4,5,1e9", "100 m"),
        ("scenario=guiding-front&at=99", "0 to 8 s"),
        ("at=3", "needs a scenario"),
        ("scenario=guiding-front&at=soon", "not a number"),
        ("scenaro=tracking", "did you mean 'scenario'"),
        ("utm_source=mail", "unknown parameter 'utm_source'"),
        ("websocket=ws://evil.example", "unknown parameter 'websocket'"),
        ("fixedDpr=nan", "not a number"),
        ("fixedDpr=50", "0.1 to 4"),
    ],
)
def test_a_wrong_link_is_told_in_one_line(query, named):
    with pytest.raises(DbbError) as told:
        Link.read(query)
    assert named in str(told.value)
    why, rest = read_link(query)
    assert why == str(told.value)
    assert read_link(rest) == ("", rest), "the rest can be opened"


@pytest.mark.parametrize(
    ("query", "left"),
    [
        (f"{LINK}&utm_source=a%20b&fbclid=%3Cscript%3E", LINK),
        (LINK.replace("d_b=0.2", "d_b=9"), LINK.replace("border.d_b=0.2&", "")),
        ("at=3&look=1,2,3,4,5,6", "look=1,2,3,4,5,6"),
        ("at=3&scenario=tracking&x", "scenario=tracking&at=3"),
        ("scenario=nowhere&at=3&controller=none", "controller=none"),
        ("x", ""),
    ],
)
def test_of_a_wrong_link_all_is_left_that_is_right(query, left):
    why, rest = read_link(query)
    assert why
    assert Link.read(rest) == Link.read(
        LINK.replace("border.d_b=0.2&", "") if left is None else left
    )


def test_a_wrong_address_is_answered_with_a_page_that_leads_to_the_right_one():
    server = open_server("127.0.0.1", 0, read_link=read_link)
    address = f"http://127.0.0.1:{server.get_port()}/?"
    try:
        assert urllib.request.urlopen(address + LINK).status == 200
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(f"{address}{LINK}&websocket=x&%3Cscript%3E=1")
    finally:
        close_server(server)
    told, page = refused.value, refused.value.read().decode()
    assert told.status == 400
    assert told.headers["Content-Type"] == "text/html; charset=utf-8"
    assert "frame-ancestors 'none'" in told.headers["Content-Security-Policy"]
    assert "unknown parameter &#x27;websocket&#x27;" in page
    assert "<script" not in page
    [(_, rest)] = [each.split('"')[1].split("?") for each in page.split("<a ")[1:]]
    assert Link.read(unescape(rest)) == Link.read(LINK)


@pytest.mark.browser
def test_a_page_follows_its_link_copies_it_and_refuses_a_wrong_one(browser):
    with served_dashboard() as served:
        tab = DashboardTab(browser, served.server.address, query=f"&{LINK}")
        wait_for(lambda: any(isinstance(c, Play) for c in served.loop.commands), what="the link")
        [played] = [c for c in served.loop.commands if isinstance(c, Play)]
        assert played == Play(SCENARIOS["guiding-front"], 4.5)
        assert Choose("barrier") in served.loop.commands
        assert served.loop.latest().config.border.d_b == 0.2
        tab.rest()
        wait_for(lambda: is_above(tab.camera()), what="the view from above")

        tab.page.context.grant_permissions(["clipboard-read", "clipboard-write"])
        tab.open_tab("Save")
        tab.click("Copy link")
        tab.wait("() => location.search.includes('d_b')")
        tab.page.get_by_label("link", exact=True).wait_for()
        wait_for(lambda: "scenario" in tab.page.evaluate("() => navigator.clipboard.readText()"))
        copied = tab.page.evaluate("() => navigator.clipboard.readText()")
        assert copied == tab.page.url
        assert copied.startswith(served.server.address)
        link = Link.read(urlsplit(copied).query)
        assert link[:2] == ("guiding-front", "barrier")
        assert (link.parameters, link.look) == ((("border.d_b", 0.2),), "top")

        count = len(served.loop.commands)
        tab.page.goto(
            f"{served.server.address}/?fixedDpr=0.5&scenario=guiding-fornt&border.d_b=0.1"
        )
        tab.page.get_by_text("did you mean 'guiding-front'").wait_for()
        assert ["400" in error for error in tab.errors] == [True]
        tab.errors.clear()
        tab.page.get_by_role("link", name="fixedDpr=0.5&border.d_b=0.1", exact=True).wait_for()
        assert [type(c).__name__ for c in served.loop.commands[count:]] == []
        tab.page.goto(f"{served.server.address}/?fixedDpr=0.5")
        tab.wait_for_scene()
        assert served.loop.latest().config.border.d_b == 0.2, "a link is obeyed once"
        assert not any(isinstance(c, (Play, Configure)) for c in served.loop.commands[count:])

        case = RunCase.of(
            RunSpec(
                "husky_panda",
                SCENARIOS["tracking"],
                Config().replace("border.d_b", 0.12),
                "dbb",
                "kinematic",
            )
        )
        content = json.loads(case.text()) | {"version": "0.1"}
        upload(tab, json.dumps(content))
        wait_for(lambda: Play(SCENARIOS["tracking"]) in served.loop.commands[count:], what="a case")
        assert served.loop.latest().config.border.d_b == 0.12
        tab.page.get_by_text("dbb 0.1 wrote the case").wait_for()
        count = len(served.loop.commands)
        upload(tab, json.dumps(content | {"robot": "frankie"}))
        tab.page.get_by_text("needs the robot frankie").wait_for()
        assert len(served.loop.commands) == count
        assert tab.errors == []


def is_above(eye):
    """Whether an eye (3,) [m] looks down at a base that has not moved."""
    return eye[2] > 4.0 * np.hypot(*eye[:2])


def upload(tab, text):
    tab.open_tab("Save")
    button = tab.page.get_by_role("button", name="Play a case", exact=True)
    with tab.page.expect_file_chooser() as chooser:
        button.click()
    file = {"name": "my.json", "mimeType": "application/json", "buffer": text.encode()}
    chooser.value.set_files(file)
