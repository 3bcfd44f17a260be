"""What many tests share: the paper's robot, compiled once, and its border from the cache."""

import signal

import pytest
from hypothesis import settings

from app.border.cache import BorderData, load_border_data
from app.robot.model import RobotModel
from tests.browser import chromium
from tests.robots import husky_panda

# A shell starts what it runs in the background with Ctrl-C ignored, and the programs that tests
# start would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


# A law does not fail because the machine is busy.
settings.register_profile("patient", deadline=None)
settings.load_profile("patient")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Slow files first, so that none is left for the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    """The paper's robot; treat it as frozen."""
    return husky_panda()


@pytest.fixture(scope="session")
def border_data(robot: RobotModel) -> BorderData:
    """Pairs and clouds of the paper's robot, as they ship."""
    return load_border_data(robot, progress=False)


@pytest.fixture(scope="module")
def browser():
    """A headless browser, one for the tests of a file."""
    with chromium() as browser:
        yield browser
