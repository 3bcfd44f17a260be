"""Every dependency has a wheel for each promised Python and platform."""

from __future__ import annotations

import re

import pytest

from tools.wheels import (
    OPTIONAL,
    PLATFORMS,
    PROJECT,
    PROMISED,
    PYTHONS,
    IndexUnreachableError,
    Outcome,
    compiled,
    resolve_all,
    table,
    written,
)

BARE = ["--no-deps", "--python-platform", PLATFORMS["Linux x86-64"], "--python-version"]


@pytest.fixture(scope="module")
def outcomes() -> dict[tuple[str, str], Outcome]:
    """The installed packages on each platform with each Python."""
    try:
        return resolve_all()
    except IndexUnreachableError as error:
        pytest.skip(f"no package index answers: {error}")


@pytest.mark.slow
def test_supported_combinations_install_from_wheels(outcomes) -> None:
    assert {cell: outcomes[cell] for cell in PROMISED if isinstance(outcomes[cell], str)} == {}


@pytest.mark.slow
def test_documented_table_matches_the_resolved_wheels(outcomes) -> None:
    assert written() == table(outcomes), "python -m tools.wheels --write"


@pytest.mark.slow
def test_exactly_one_mujoco_and_at_most_one_pybullet_is_installed(outcomes) -> None:
    for cell, names in outcomes.items():
        assert not {"pybullet", "pybullet-arm64"} <= names, cell
        assert len({"mujoco", "mujoco-core"} & names) == 1, cell


@pytest.mark.slow
def test_only_pybullet_is_omitted_and_only_by_its_markers(outcomes) -> None:
    """On the supported platforms; the upper bound of `requires-python` has no gaps."""
    for platform, python in PROMISED:
        names = outcomes[platform, python]
        assert bool({"pybullet", "pybullet-arm64"} & names) == (python != "3.14")
        assert names >= direct() - set(OPTIONAL) - {"tomli"}


@pytest.mark.slow
def test_missing_wheel_is_detected(tmp_path) -> None:
    wanted = tmp_path / "wanted.in"
    wanted.write_text("pybullet==3.2.7\n", encoding="utf-8")
    try:
        assert compiled([str(wanted), *BARE, "3.11"]) == frozenset({"pybullet"})
        why = compiled([str(wanted), *BARE, "3.13"])
    except IndexUnreachableError as error:
        pytest.skip(f"no package index answers: {error}")
    assert isinstance(why, str)
    assert "pybullet" in why


def test_unreachable_index_is_not_a_missing_wheel(tmp_path, monkeypatch) -> None:
    """No server listens on that port of this machine."""
    wanted = tmp_path / "wanted.in"
    wanted.write_text("numpy\n", encoding="utf-8")
    monkeypatch.setenv("UV_DEFAULT_INDEX", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("UV_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("UV_HTTP_RETRIES", "0")
    with pytest.raises(IndexUnreachableError, match=r"127\.0\.0\.1:9"):
        compiled([str(wanted), *BARE, "3.11"])


def test_table_shows_no_for_a_missing_wheel() -> None:
    outcomes: dict[tuple[str, str], Outcome] = {
        (platform, python): frozenset({"pin", "mujoco"})
        for platform in PLATFORMS
        for python in PYTHONS
    }
    outcomes["macOS arm64", "3.14"] = "pin has no wheels"
    last = table(outcomes).splitlines()[-1]
    assert last == "| macOS arm64 | MuJoCo | MuJoCo | MuJoCo | MuJoCo | no |"


def test_supported_pythons_are_those_of_requires_python() -> None:
    low, high = re.findall(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', PYPROJECT)[0]
    assert [f"3.{minor}" for minor in range(int(low), int(high))] == list(PYTHONS)
    assert {python for _, python in PROMISED} == set(PYTHONS)


PYPROJECT = (PROJECT / "pyproject.toml").read_text(encoding="utf-8")


def direct() -> set[str]:
    """Names of the dependencies of the package itself and of all extras."""
    text = PYPROJECT[PYPROJECT.index("\ndependencies = [") : PYPROJECT.index("[project.scripts]")]
    names = {name.lower() for name in re.findall(r'^    "([A-Za-z0-9_.-]+)', text, re.M)}
    return names - {"dbb-mobile-manipulator"}  # an extra that includes another one
