"""An uploaded zip becomes a robot, in a separate process that can be cancelled."""

from __future__ import annotations

import os
import re
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from html import unescape
from pathlib import Path

import pytest
from viser import _messages

from app.dashboard import robots
from app.dashboard.page import Page
from app.dashboard.panels.robot import FIND, in_words, outcome_html, report_html, robot_name
from app.dashboard.robots import RobotBuild, RobotSwitch
from app.dashboard.server import DashboardServer, serve_dashboard
from app.errors import ConfigError, LoopError, RobotFileError
from app.jobs.process import Cancelled, run_in_process
from app.onboarding.read.package import look_into
from app.onboarding.request import Request
from app.strict import LARGEST_TEXT
from tests.browser import wait_for
from tests.dashboards import clouds, parts
from tests.fakes import ScriptedLoop
from tests.jobs import (
    count_up,
    fail_with,
    nothing_for_a_request,
    vanish,
    wait_for_ever,
    wait_for_ever_for_a_request,
    wait_in_a_folder,
)
from tests.onboarding import arm, cart, robot, zipped
from tests.raw_client import RawClient
from tests.robots import husky_panda

pytestmark = pytest.mark.slow

TOY = robot([*cart(), *arm()])


def test_job_in_a_process_reports_progress_and_returns_its_result() -> None:
    shares: list[float] = []
    pid = run_in_process(
        count_up, 4, report=lambda _, share: shares.append(share), cancelled=threading.Event()
    )
    assert shares == [0.0, 0.25, 0.5, 0.75]
    assert pid != os.getpid()
    assert gone(pid)


def test_failed_job_raises_its_error() -> None:
    stopping = threading.Event()
    for raised, error, words in (
        (RobotFileError("no wheel"), RobotFileError, "no wheel"),
        (ZeroDivisionError("a defect"), ZeroDivisionError, "a defect"),
    ):
        with pytest.raises(error, match=words) as caught:
            run_in_process(fail_with, raised, report=lambda *_: None, cancelled=stopping)
        assert "in fail_with" in str(caught.value.__cause__)
    with pytest.raises(LoopError, match="status 7"):
        run_in_process(vanish, report=lambda *_: None, cancelled=stopping)


def test_cancelled_job_ends_with_its_child_processes(tmp_path: Path) -> None:
    stopping, file = threading.Event(), tmp_path / "child"
    with pytest.raises(Cancelled):
        run_in_process(
            wait_for_ever, str(file), report=lambda *_: stopping.set(), cancelled=stopping
        )
    wait_for(lambda: gone(int(file.read_text())), what="the end of the child's child")


def test_cancelled_job_runs_its_finally_blocks(tmp_path: Path) -> None:
    stopping = threading.Event()
    with pytest.raises(Cancelled):
        run_in_process(
            wait_in_a_folder,
            str(tmp_path / "toy"),
            report=lambda *_: stopping.set(),
            cancelled=stopping,
        )
    assert list(tmp_path.iterdir()) == []


def gone(pid: int) -> bool:
    """Whether a process has ended, including one whose status no process has read."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except FileNotFoundError:
        return True


@pytest.fixture
def making(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[RobotBuild]:
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path / "user"))
    made = RobotBuild(RobotSwitch(None))
    yield made
    made.close()


def ended(making: RobotBuild) -> None:
    wait_for(lambda: making.progress is None, what="the end of the job")


def test_contents_of_a_zip_are_listed_before_the_robot_is_made(tmp_path: Path) -> None:
    found = look_into(zipped(tmp_path, {"b/toy.urdf": TOY, "a/broken.urdf": "<robot>"}))
    ((name, contents),) = found.items()
    assert name == "b/toy.urdf"
    assert (contents.root, contents.last) == ("base", "hand")
    assert contents.endless == ("left_axle", "right_axle")
    assert "column" in contents.links


@pytest.mark.parametrize(
    ("links", "joints", "words"),
    [
        (5_000, 4_999, "it has 5000 links; . to 500 are valid"),
        (2, 9_000, "it has 9000 joints; . to 500 are valid"),
        (60_000, 59_999, "more than 30,000 elements"),
    ],
)
def test_oversized_urdf_is_rejected_before_its_links_are_listed(
    tmp_path: Path, links: int, joints: int, words: str
) -> None:
    text = chain(links, joints)
    assert len(text) < LARGEST_TEXT
    begin = time.process_time()
    with pytest.raises(RobotFileError, match=words):
        look_into(zipped(tmp_path, {"long.urdf": text}))
    assert time.process_time() - begin < 5.0


def test_longest_accepted_chain_is_listed_completely(tmp_path: Path) -> None:
    ((_, contents),) = look_into(zipped(tmp_path, {"long.urdf": chain(500, 499)})).items()
    assert (contents.root, contents.last, len(contents.links)) == ("l0", "l499", 500)


def chain(links: int, joints: int) -> str:
    """A URDF with a chain of fixed links, in reverse order."""
    rows = [f'<link name="l{i}"/>' for i in reversed(range(links))]
    rows += [
        f'<joint name="j{i}" type="fixed"><parent link="l{i}"/><child link="l{i + 1}"/></joint>'
        for i in range(joints)
    ]
    return robot(rows)


@pytest.mark.usefixtures("made_here")
def test_zip_is_stored_until_the_next_upload(
    making: RobotBuild, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    upload_folder = tmp_path / "uploads"
    upload_folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(upload_folder))
    content = zipped(tmp_path, {"toy.urdf": TOY}).read_bytes()
    making.receive("../My Robot (2).ZIP", content)
    ended(making)
    assert making.package is not None, making.problem
    first = making.package.archive
    assert first.name == "myrobot2.zip"
    assert first.read_bytes() == content
    making.receive("no.zip", b"nothing")
    ended(making)
    assert making.package is None
    assert "not a zip" in making.problem
    assert "not a zip" in outcome_html(making)
    assert not first.exists()
    assert list(upload_folder.iterdir()) == []  # of the second zip too


def test_only_one_job_runs_and_it_can_be_cancelled(
    making: RobotBuild, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    request = Request("toy.zip", "base", "hand", tmp_path / "user" / "toy")
    monkeypatch.setattr(robots, "build_robot", wait_for_ever_for_a_request)
    making.build(request)
    wait_for(lambda: making.progress is None or making.progress.text == "waiting", what="work")
    with pytest.raises(ConfigError, match="cancel this job first"):
        making.build(request)
    making.cancel()
    ended(making)
    assert "cancelled" in making.problem
    assert list((tmp_path / "user").iterdir()) == []
    with pytest.raises(ConfigError, match="a robot 'husky_panda' exists"):
        making.build(Request("toy.zip", "base", "hand", tmp_path / "user" / "husky_panda"))
    with pytest.raises(RobotFileError, match="letters, digits"):
        making.build(Request("toy.zip", "base", "hand", tmp_path / "user" / "a b"))


def test_rejected_request_is_reported_and_leaves_no_files(
    making: RobotBuild, tmp_path: Path
) -> None:
    """The complete path, with a separate process."""
    making.receive("toy.zip", zipped(tmp_path, {"toy.urdf": TOY}).read_bytes())
    ended(making)
    assert making.package is not None
    making.build(Request(str(making.package.archive), "bse", "hand", tmp_path / "user" / "toy"))
    ended(making)
    assert "the URDF has no link 'bse' (did you mean 'base'?)" in making.problem
    assert list((tmp_path / "user").iterdir()) == []


@pytest.fixture(scope="module")
def server() -> Iterator[DashboardServer]:
    loop = ScriptedLoop(husky_panda())
    loop.start()
    made = serve_dashboard(
        loop,
        husky_panda(),
        clouds(),
        port=0,
        parts=parts(),
        start_loop=lambda *_: ScriptedLoop(husky_panda()),
    )
    yield made
    made.stop()
    loop.stop()


@contextmanager
def visitor(server: DashboardServer) -> Iterator[tuple[RawClient, Page]]:
    """A client without a browser, and its page."""
    known = set(server.pages)
    with RawClient(server.address) as client:
        wait_for(lambda: set(server.pages) - known, what="a page")
        yield client, server.pages[max(server.pages)]


@pytest.mark.usefixtures("made_here")
def test_form_is_filled_from_the_upload_and_gives_the_request(
    server: DashboardServer, tmp_path: Path
) -> None:
    content = zipped(tmp_path, {"toy/toy.urdf": TOY}).read_bytes()
    with visitor(server) as (client, page):
        panel = page.robot_panel
        assert panel is not None
        own = panel.own
        upload(client, own.uploads._impl.uuid, "Toy-1.zip", content)
        wait_for(lambda: own.fields["tip"].value == "hand", what="the questions")
        assert own.fields["base"].value == "base"
        request = own.request()
        assert (request.name, request.wheels, request.file) == ("toy_1", None, "toy/toy.urdf")
        for name in ("/tmp/evil", "../../evil", "toy/", ""):
            client.set_widget(own.fields["out"], name)
            wait_for(lambda name=name: own.fields["out"].value == name)
            with pytest.raises(ConfigError, match="letters, digits"):
                own.request()
        client.set_widget(own.fields["out"], "toy_1")
        wait_for(lambda: own.fields["out"].value == "toy_1")
        client.set_widget(own.fields["left"], "left_axle")
        wait_for(lambda: own.fields["left"].value == "left_axle")
        with pytest.raises(ConfigError, match="both wheels"):
            own.request()
        client.set_widget(own.fields["left"], FIND)
        wait_for(lambda: own.fields["left"].value == FIND)
        for number, words in (
            (0.1, "needs “Half track”, and excludes “Left wheel”"),
            (0.001, "0.001 m is not within 0.01 to 1 m"),
            (-1.0, "not within"),
        ):
            client.set_widget(own.fields["wheel_radius"], number)
            wait_for(lambda n=number: repr(own.fields["wheel_radius"].value) == repr(n))
            with pytest.raises(ConfigError, match=words):
                own.request()


@pytest.mark.usefixtures("made_here")
def test_form_shows_only_fields_of_the_kind_of_base_and_ignores_others(
    server: DashboardServer, tmp_path: Path
) -> None:
    content = zipped(tmp_path, {"toy/toy.urdf": TOY}).read_bytes()
    with visitor(server) as (client, page):
        assert page.robot_panel is not None
        own = page.robot_panel.own
        upload(client, own.uploads._impl.uuid, "half.zip", content)
        wait_for(lambda: own.fields["out"].value == "half", what="the questions")  # for this zip
        client.set_widget(own.fields["half_track"], 0.2)
        wait_for(lambda: own.request().half_track == 0.2)
        for kind, expected in (
            ("holonomic", set()),
            ("car-like", {"left", "right", "wheelbase", "steering_limit"}),
            ("differential", {"left", "right", "half_track", "wheel_radius"}),
        ):
            client.set_widget(own.fields["kind"], kind)
            wait_for(lambda kind=kind: own.fields["kind"].value == kind)
            wait_for(
                lambda expected=expected: (
                    {n for n, field in own.fields.items() if field.visible}
                    == {"out", "base", "tip", "kind", "assume_inertia", *expected}
                ),
                what="the fields of this kind",
            )
            assert own.request().half_track == (0.2 if kind == "differential" else None)


@pytest.mark.usefixtures("made_here")
def test_upload_is_not_stored_in_the_page_and_deleted_after_the_build(
    server: DashboardServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robots, "build_robot", nothing_for_a_request)
    with visitor(server) as (client, page):
        assert page.robot_panel is not None
        own, made = page.robot_panel.own, server.shared.robot_build
        before = made.package
        content = zipped(tmp_path, {"toy/toy.urdf": TOY}).read_bytes()
        upload(client, own.uploads._impl.uuid, "toy.zip", content)
        wait_for(lambda: made.package is not before and made.progress is None, what="the package")
        assert made.package is not None
        archive = made.package.archive
        assert archive.read_bytes() == content
        assert own.uploads.value.content == b""
        made.build(Request(str(archive), "base", "hand", tmp_path / "toy"))
        ended(made)
        assert made.built == "toy", made.problem
        assert made.package is None
        assert not archive.exists()
        wait_for(lambda: "is ready" in own.status.text.content, what="the report of success")


def test_messages_name_form_fields_instead_of_options() -> None:
    assert in_words("--wheelbase: give --wheelbase, or --wheels") == (
        "“Wheelbase”: give “Wheelbase”, or “Left wheel” and “Right wheel”"
    )
    assert in_words("give --mount and --base-x") == "give --mount and --base-x"


@pytest.mark.usefixtures("made_here")
def test_second_upload_replaces_the_links_in_the_form(
    server: DashboardServer, tmp_path: Path
) -> None:
    other = TOY.replace('"hand"', '"gripper"')
    with visitor(server) as (client, page):
        assert page.robot_panel is not None
        own = page.robot_panel.own
        for urdf, tip in ((other, "gripper"), (TOY, "hand")):
            content = zipped(tmp_path, {"toy/toy.urdf": urdf}).read_bytes()
            upload(client, own.uploads._impl.uuid, "toy.zip", content)
            wait_for(lambda tip=tip: own.fields["tip"].value == tip, what="the questions")
            wait_for(lambda: server.shared.robot_build.progress is None)


def test_oversized_or_excess_uploads_are_rejected_before_transfer(
    server: DashboardServer,
) -> None:
    with visitor(server) as (client, page):
        assert page.robot_panel is not None
        uuid, gui = page.robot_panel.own.uploads._impl.uuid, page.client.gui
        states = gui._current_file_upload_states
        begin(client, uuid, "a", 10**9, 1000)
        begin(client, uuid, "b", 100, 10**12)
        begin(client, uuid, "c", 100, 2)
        wait_for(lambda: "c" in states, what="a valid upload")
        assert set(states) == {"c"}
        begin(client, uuid, "d", 100, 2)
        begin(client, uuid, "e", 100, 2)
        wait_for(lambda: "d" in states)
        time.sleep(0.2)
        assert set(states) == {"c", "d"}
        client.send(_messages.FileTransferPart(uuid, "c", 0, b"x" * 10))
        wait_for(lambda: states["c"]["transferred_bytes"] == 10, what="a part of the file")
    wait_for(lambda: not states, what="removal of the uploads")


def begin(client: RawClient, uuid: str, name: str, size: int, parts: int) -> None:
    client.send(
        _messages.FileTransferStartUpload(uuid, name, f"{name}.zip", "application/zip", parts, size)
    )


def upload(client: RawClient, uuid: str, name: str, content: bytes) -> None:
    client.send(
        _messages.FileTransferStartUpload(uuid, "t1", name, "application/zip", 1, len(content))
    )
    client.send(_messages.FileTransferPart(uuid, "t1", 0, content))


@pytest.mark.parametrize(
    ("stem", "name"),
    [("toy", "toy"), ("My Robot-2", "my_robot_2"), ("7dof", "robot_7dof"), ("é", "robot")],
)
def test_file_name_gives_a_valid_robot_name(stem: str, name: str) -> None:
    assert robot_name(stem) == name
    assert Request("", "", "", Path("/x") / name).name == name


def test_report_is_shown_in_a_sandbox_without_scripts() -> None:
    page = '<body class="x">{1}"><script>alert()</script></body>'
    shown = report_html(page)
    assert "<iframe " in shown
    assert " sandbox " in shown
    assert "<script" not in shown
    (found,) = re.findall(r'srcdoc="([^"]*)"', shown)
    assert unescape(found) == page
