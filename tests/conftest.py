"""Shared fixtures: the paper's robot, compiled once, and its border from the cache."""

import signal
from asyncio import events
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from functools import partial
from importlib.util import find_spec
from typing import Any

import pytest
from hypothesis import settings

from app.border import cache
from app.border.cache import BorderData, load_border_data
from app.cli import common
from app.dashboard import job
from app.errors import DbbError
from app.jobs.process import run_in_process
from app.robot.model import RobotModel
from app.simulation.trace import arrow
from tests.browser import chromium
from tests.robots import husky_panda

# A shell starts background programs with Ctrl-C ignored, and nohup ignores SIGHUP. The programs
# that tests start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


# A law does not fail because the machine is busy.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


_LONGEST = (
    "test_onboarding_robot",
    "test_dashboard_browser",
    "test_screenshot",
    "test_browser_layers",
    "test_browser_downloads",
    "test_browser_upload",
    "test_oracle",
    "test_refrigerator",
    "test_postures",
    "test_study_run",
    "test_cli",
    "test_end_to_end",
    "test_accessibility",
)
"""Files of more than half a minute, the longest first: at the end one of them would run alone."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files first, then those with anything slow; short ones fill up the workers.

    A page that was late is looked at again.
    """

    def is_slow(item: pytest.Item) -> bool:
        return any(item.get_closest_marker(name) for name in ("slow", "browser"))

    slow = {item.path for item in items if is_slow(item)}
    rank = {name: k for k, name in enumerate(_LONGEST)}
    last = len(rank)
    items.sort(key=lambda item: rank.get(item.path.stem, last + (item.path not in slow)))
    for item in items:
        if item.get_closest_marker("browser"):  # it draws in software, beside all other tests
            item.add_marker(pytest.mark.flaky(reruns=2))


@contextmanager
def _what_needs_pybullet() -> Generator[None]:
    """Skip a test without wheels if it ends with the line that requires them."""
    try:
        yield
    except DbbError as error:
        if find_spec("pybullet") is None and "pybullet" in str(error):
            pytest.skip(str(error))
        raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """Fixtures that need pybullet, or an event loop of their own."""
    with _what_needs_pybullet(), _without_event_loop(item):
        return (yield)


@contextmanager
def _without_event_loop(item: pytest.Item) -> Generator[None]:
    """Let a test without a browser run an event loop.

    Playwright's event loop counts as running in this thread for as long as the browser is open.
    """
    of_browser = events._get_running_loop()
    if of_browser is None or "browser" in getattr(item, "fixturenames", ()):
        yield
        return
    events._set_running_loop(None)
    try:
        yield
    finally:
        events._set_running_loop(of_browser)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Generator[None]:
    """Tests that need pybullet, or an event loop of their own."""
    with _what_needs_pybullet(), _without_event_loop(item):
        return (yield)


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    """The paper's robot; treat it as frozen."""
    return husky_panda()


@pytest.fixture(scope="session")
def border_data(robot: RobotModel) -> BorderData:
    """Pairs and clouds of the paper's robot, as they ship."""
    return load_border_data(robot, progress=False)


@pytest.fixture(autouse=True)
def _logs_are_read_here(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """A log is read in this process, but by tests of the budget for that.

    The child process that reads a larger one takes most of the time for its imports.
    """
    if not request.node.get_closest_marker("budget"):
        monkeypatch.setattr(arrow, "within_budget", lambda read, *args, **_: read(*args))


@pytest.fixture
def loaded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Commands in this process share a robot and its border as long as its description is equal."""
    load_model, load_border = common.load_model, cache.load_border_data

    def model_of(robot: str) -> RobotModel:
        fresh = load_model(robot)  # errors of its files are raised each time
        return _models.setdefault(fresh.description.model_dump_json(), fresh)

    def border_of(model: RobotModel, **how: Any) -> BorderData:
        if how:  # sampled with the given options
            return load_border(model, **how)
        if model not in _borders:
            _borders[model] = load_border(model)
        return _borders[model]

    monkeypatch.setattr(common, "load_model", model_of)
    monkeypatch.setattr(cache, "load_border_data", border_of)


_models: dict[str, RobotModel] = {}
_borders: dict[RobotModel, BorderData] = {}


@pytest.fixture(scope="session")
def only_browser() -> Iterator[Any]:
    """A headless browser for all tests of this process: its start takes seconds."""
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def browser(only_browser: Any) -> Iterator[Any]:
    """The browser; files of its pages are made at the tests' own priority, without delay."""
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(job, "run_in_process", partial(run_in_process, niceness=0))
        yield only_browser


@pytest.fixture(autouse=True)
def _tabs_end_with_their_test(request: pytest.FixtureRequest):
    """Close the objects of a test, also if it failed, because its server lives longer."""
    if "browser" not in request.fixturenames:
        yield
        return
    browser = request.getfixturevalue("browser")
    before = list(browser.contexts)
    yield
    for context in browser.contexts:
        if context not in before:
            context.close()
