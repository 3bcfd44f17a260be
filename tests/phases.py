"""The two phases of `make test`, as a plugin of pytest: `-p tests.phases --phase together`.

First runs, side by side, what may; then, one by one, what needs the machine for itself.
`--phase` is an option of its own, so that -m and -k are left to whoever calls `make test`.
"""

from __future__ import annotations

import pytest

PHASES = ("together", "alone")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Adds `--phase`."""
    parser.addoption("--phase", choices=PHASES, required=True, help="of the tests that are chosen")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests of one phase, slow files first, so that none is left for the end.

    Those in a browser have three tries: it draws in software on the cores of the simulation.
    """
    parted: dict[str, list[pytest.Item]] = {name: [] for name in PHASES}
    for item in items:
        parted[phase_of(item)].append(item)
    kept = parted.pop(config.getoption("phase"))
    config.hook.pytest_deselected(items=[item for others in parted.values() for item in others])
    for item in kept:
        if item.get_closest_marker("browser"):
            item.add_marker(pytest.mark.flaky(reruns=2))
    slow = {item.path for item in kept if item.get_closest_marker("slow")}
    items[:] = sorted(kept, key=lambda item: item.path not in slow)


def phase_of(item: pytest.Item) -> str:
    """Alone is what is marked so, and what has a browser."""
    alone = item.get_closest_marker("alone") or item.get_closest_marker("browser")
    return "alone" if alone else "together"
