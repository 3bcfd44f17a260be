"""Shared fixtures: the paper's robot, compiled once, and its border from the cache."""

import math
import signal
from asyncio import events
from collections.abc import Generator, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from importlib.util import find_spec
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from app.border import cache
from app.border.cache import BorderData, load_border_data
from app.border.sampling import SamplingConfig
from app.cli import common
from app.dashboard import job
from app.errors import DbbError
from app.jobs import bounded
from app.jobs.process import run_in_process
from app.robot.model import RobotModel
from tests.browser import chromium
from tests.robots import husky_panda

# A shell starts background programs with Ctrl-C ignored, and nohup ignores SIGHUP. The programs
# that tests start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGHUP"):
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


# A busy machine must not fail a property test.
settings.register_profile(
    "patient", deadline=None, max_examples=40, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("patient")


_SMALL = bounded.SMALL

_LONGEST = (
    "test_onboarding_robot",
    "test_dashboard_browser",
    "test_browser_layers",
    "test_robots_shipped",
    "test_screenshot",
    "test_screens",
    "test_browser_downloads",
    "test_study_run",
    "test_refrigerator",
    "test_dashboard",
    "test_cli",
    "test_own_loop",
    "test_oracle",
    "test_jobs",
    "test_browser_upload",
)
"""Files that take over 15 s, the longest first: a long file that starts last runs alone."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Run the longest files first, then files with a slow test, then short ones.

    A browser test that fails runs again, because a busy machine can delay its page.
    """

    def is_slow(item: pytest.Item) -> bool:
        return any(item.get_closest_marker(name) for name in ("slow", "browser"))

    slow = {item.path for item in items if is_slow(item)}
    rank = {name: k for k, name in enumerate(_LONGEST)}
    last = len(rank)
    items.sort(key=lambda item: rank.get(item.path.stem, last + (item.path not in slow)))
    for item in items:
        if item.get_closest_marker("browser"):  # it renders in software while other tests run
            item.add_marker(pytest.mark.flaky(reruns=2))


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print the failure of each test that ran again."""
    for report in terminalreporter.stats.get("rerun", []):
        terminalreporter.section(f"failed, ran again: {report.nodeid}")
        terminalreporter.write_line(report.longreprtext)


@contextmanager
def _skip_without_pybullet() -> Generator[None]:
    """Skip a test that fails only because pybullet is not installed."""
    try:
        yield
    except DbbError as error:
        if find_spec("pybullet") is None and "pybullet" in str(error):
            pytest.skip(str(error))
        raise


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Generator[None]:
    """Set up fixtures in `_skip_without_pybullet` and `_without_event_loop`."""
    with _skip_without_pybullet(), _without_event_loop(item):
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
    """Run the test in `_skip_without_pybullet` and `_without_event_loop`."""
    with _skip_without_pybullet(), _without_event_loop(item):
        return (yield)


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    """The paper's robot; treat it as frozen."""
    return husky_panda()


@pytest.fixture(scope="session")
def border_data(robot: RobotModel) -> BorderData:
    """The shipped pairs and clouds of the paper's robot."""
    return load_border_data(robot, progress=False)


@pytest.fixture(scope="session", autouse=True)
def _read_in_this_process() -> Iterator[None]:
    """Read large data of users in this process, except in tests of the budget for reading.

    A child process would spend most of its time on imports.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bounded, "SMALL", math.inf)
        yield


@pytest.fixture(scope="session", autouse=True)
def _only_small_borders() -> Iterator[None]:
    """Refuse to sample a border at the delivered size: that takes minutes in a new clone."""
    sample = cache.sample_clouds

    def small(model: RobotModel, pairs: Any, config: SamplingConfig, **how: Any) -> Any:
        assert config != SamplingConfig(), "use `border_data` or fewer samples"
        return sample(model, pairs, config, **how)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cache, "sample_clouds", small)
        yield


@pytest.fixture(autouse=True)
def _read_within_budget(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Restore the child processes that read large data in tests with the marker `budget`."""
    if request.node.get_closest_marker("budget"):
        monkeypatch.setattr(bounded, "SMALL", _SMALL)


@pytest.fixture
def loaded_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let commands in this process share the model and the border of equal descriptions."""
    load_model, load_border = common.load_model, cache.load_border_data

    def model_of(robot: str) -> RobotModel:
        fresh = load_model(robot)  # errors of its files are raised each time
        return _models.setdefault(fresh.description.model_dump_json(), fresh)

    def border_of(model: RobotModel, **how: Any) -> BorderData:
        if how:  # sampled with options
            return load_border(model, **how)
        if model not in _borders:
            _borders[model] = load_border(model)
        return _borders[model]

    monkeypatch.setattr(common, "load_model", model_of)
    monkeypatch.setattr(cache, "load_border_data", border_of)


@pytest.fixture
def made_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the dashboard's jobs work in this process; a film still has a process of its own.

    A limit of processor time would include the other threads of this process, and end it.
    """
    monkeypatch.setattr(job.Job, "run", lambda self, work, *args: work(self.report, *args))
    monkeypatch.setattr(job, "limited", lambda *_: nullcontext())


_models: dict[str, RobotModel] = {}
_borders: dict[RobotModel, BorderData] = {}


@pytest.fixture(scope="session")
def only_browser() -> Iterator[Any]:
    """A headless browser for all tests of this process: its start takes seconds."""
    with chromium() as browser:
        yield browser


@pytest.fixture(scope="module")
def browser(only_browser: Any) -> Iterator[Any]:
    """The browser; files of its pages are made at normal process priority."""
    with pytest.MonkeyPatch.context() as changed:
        changed.setattr(job, "run_in_process", partial(run_in_process, niceness=0))
        yield only_browser


@pytest.fixture(autouse=True)
def _close_tabs(request: pytest.FixtureRequest):
    """Close the browser contexts of a test, also after a failure; its server continues."""
    if "browser" not in request.fixturenames:
        yield
        return
    browser = request.getfixturevalue("browser")
    before = list(browser.contexts)
    yield
    for context in browser.contexts:
        if context not in before:
            context.close()
