"""Every dependency comes as a wheel for each Python and platform of the promise."""

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
def test_all_of_the_promise_is_installed_from_wheels(outcomes) -> None:
    assert {cell: outcomes[cell] for cell in PROMISED if isinstance(outcomes[cell], str)} == {}


@pytest.mark.slow
def test_the_documents_table_is_the_one_that_is_found(outcomes) -> None:
    assert written() == table(outcomes), "python -m tools.wheels --write"


@pytest.mark.slow
def test_never_pybullet_and_its_fork_and_everywhere_one_mujoco(outcomes) -> None:
    for cell, names in outcomes.items():
        assert not {"pybullet", "pybullet-arm64"} <= names, cell
        assert len({"mujoco", "mujoco-core"} & names) == 1, cell


@pytest.mark.slow
def test_only_pybullet_is_left_out_and_only_where_the_markers_say(outcomes) -> None:
    """On the supported platforms; `requires-python` has an upper bound without gaps."""
    for platform, python in PROMISED:
        names = outcomes[platform, python]
        assert bool({"pybullet", "pybullet-arm64"} & names) == (python != "3.14")
        assert names >= direct() - set(OPTIONAL) - {"tomli"}


@pytest.mark.slow
def test_a_package_without_a_wheel_is_seen(tmp_path) -> None:
    wanted = tmp_path / "wanted.in"
    wanted.write_text("pybullet==3.2.7\n", encoding="utf-8")
    try:
        assert compiled([str(wanted), *BARE, "3.11"]) == frozenset({"pybullet"})
        why = compiled([str(wanted), *BARE, "3.13"])
    except IndexUnreachableError as error:
        pytest.skip(f"no package index answers: {error}")
    assert isinstance(why, str)
    assert "pybullet" in why


def test_an_index_that_does_not_answer_is_no_missing_wheel(tmp_path, monkeypatch) -> None:
    """Nothing listens at that port of this machine."""
    wanted = tmp_path / "wanted.in"
    wanted.write_text("numpy\n", encoding="utf-8")
    monkeypatch.setenv("UV_DEFAULT_INDEX", "http://127.0.0.1:9/simple")
    monkeypatch.setenv("UV_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("UV_HTTP_RETRIES", "0")
    with pytest.raises(IndexUnreachableError, match=r"127\.0\.0\.1:9"):
        compiled([str(wanted), *BARE, "3.11"])


def test_the_table_says_no_where_something_has_no_wheel() -> None:
    outcomes: dict[tuple[str, str], Outcome] = {
        (platform, python): frozenset({"pin", "mujoco"})
        for platform in PLATFORMS
        for python in PYTHONS
    }
    outcomes["macOS arm64", "3.14"] = "pin has no wheels"
    last = table(outcomes).splitlines()[-1]
    assert last == "| macOS arm64 | MuJoCo | MuJoCo | MuJoCo | MuJoCo | no |"


def test_the_promise_is_for_every_python_that_the_package_takes() -> None:
    low, high = re.findall(r'requires-python = ">=3\.(\d+),<3\.(\d+)"', PYPROJECT)[0]
    assert [f"3.{minor}" for minor in range(int(low), int(high))] == list(PYTHONS)
    assert {python for _, python in PROMISED} == set(PYTHONS)


PYPROJECT = (PROJECT / "pyproject.toml").read_text(encoding="utf-8")


def direct() -> set[str]:
    """Names of the dependencies of the package itself and of all extras."""
    text = PYPROJECT[PYPROJECT.index("\ndependencies = [") : PYPROJECT.index("[project.scripts]")]
    names = {name.lower() for name in re.findall(r'^    "([A-Za-z0-9_.-]+)', text, re.M)}
    return names - {"dbb-mobile-manipulator"}  # an extra that takes another in
