"""`make run` and `make test` install versions pinned with hashes, within pyproject's bounds."""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import pytest
import tomli
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).resolve().parent.parent
EXTRAS = ("all", "dev")
ENVIRONMENTS = [
    {
        "python_version": python,
        "python_full_version": f"{python}.0",
        "sys_platform": system,
        "platform_system": system.capitalize(),
        "platform_machine": machine,
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
    }
    for python, (system, machine) in product(
        ("3.10", "3.11", "3.12", "3.13", "3.14"), (("linux", "x86_64"), ("darwin", "arm64"))
    )
]


def locked(extra: str) -> dict[Requirement, int]:
    """The pinned packages in `requirements/EXTRA.txt`, each with the number of its hashes."""
    text = (PROJECT / "requirements" / f"{extra}.txt").read_text(encoding="utf-8")
    blocks = re.split(r"\n(?=\S)", re.sub(r"^#.*\n", "", text, flags=re.M).strip())
    return {
        Requirement(block.split(" \\\n")[0]): len(re.findall(r"--hash=sha256:[0-9a-f]{64}", block))
        for block in blocks
    }


def required(extra: str) -> Iterator[Requirement]:
    """The requirements of the package and one of its extras, including extras within it."""
    project = tomli.loads((PROJECT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    waiting = [*project["dependencies"], *project["optional-dependencies"][extra]]
    while waiting:
        requirement = Requirement(waiting.pop())
        if requirement.name == project["name"]:
            for inner in requirement.extras:
                waiting += project["optional-dependencies"][inner]
        else:
            yield requirement


def holds(requirement: Requirement, environment: dict[str, str]) -> bool:
    return requirement.marker is None or requirement.marker.evaluate(environment)


@pytest.mark.parametrize("extra", EXTRAS)
def test_every_pin_is_one_version_with_hashes(extra: str) -> None:
    pins = locked(extra)
    assert len(pins) > 50
    for pin, hashes in pins.items():
        assert re.fullmatch(r"==[^*,]+", str(pin.specifier)), pin
        assert hashes > 0, pin


@pytest.mark.parametrize(
    "environment", ENVIRONMENTS, ids=lambda e: f"{e['python_version']}-{e['sys_platform']}"
)
@pytest.mark.parametrize("extra", EXTRAS)
def test_each_requirement_is_pinned_once_within_its_bounds(
    extra: str, environment: dict[str, str]
) -> None:
    """After a change of pyproject.toml, run tools/lock.sh."""
    pins = [pin for pin in locked(extra) if holds(pin, environment)]
    for requirement in required(extra):
        name = canonicalize_name(requirement.name)
        versions = [str(p.specifier)[2:] for p in pins if canonicalize_name(p.name) == name]
        if not holds(requirement, environment):
            continue
        assert len(versions) == 1, requirement
        assert requirement.specifier.contains(versions[0], prereleases=True), requirement


def test_make_test_includes_the_pins_of_make_run() -> None:
    run, tried = ({(pin.name, str(pin.specifier)) for pin in locked(extra)} for extra in EXTRAS)
    assert run <= tried
