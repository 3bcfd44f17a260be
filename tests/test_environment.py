"""A user's locale, folders and time zone do not change results."""

from __future__ import annotations

import codecs
import csv
import os
import re
import shutil
import subprocess
import sys
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from app import system
from app.cli.main import main
from app.cli.options import configured
from app.config import Config
from app.config_file import decode_config, read_config, save_config
from app.errors import CaseError, ConfigError, DbbError, LogError, UnknownNameError
from app.robot import assets
from app.robot.description import load_description, load_robot
from app.simulation.case import read_case
from app.simulation.trace.log_file import read_trace, write_trace
from tests.logs import random_snapshots, trace_of
from tests.readme import PROJECT

COMMAS = "decimal_commas"
RUN = f"""
import ctypes, hashlib, locale, os, resource
from itertools import islice

if "LOCPATH" in os.environ:
    locale.setlocale(locale.LC_NUMERIC, "{COMMAS}")
    assert locale.localeconv()["decimal_point"] == ","
if "FILES" in os.environ:
    resource.setrlimit(resource.RLIMIT_NOFILE, (int(os.environ["FILES"]),) * 2)

from app.border.cache import border_key, load_border_data
from app.border.sampling import SamplingConfig
from app.cli.common import load_model
from app.simulation.case import RunSpec
from app.simulation.plants import default_plant
from app.simulation.run import steps_of
from app.simulation.scenarios import SCENARIOS

model = load_model("husky_panda")
print(border_key(model.description, SamplingConfig()))
data = load_border_data(model)
for plant in sorted({{default_plant(), "mujoco", "mujoco-contact", "kinematic"}}):
    scenario, config = SCENARIOS["guiding-front"], model.description.config
    spec = RunSpec("husky_panda", scenario, config, "dbb", plant, 0)
    digest = hashlib.sha256()
    for _, step in islice(steps_of(spec, model, data), 150):
        for numbers in (*step.truth[:4], step.control.u_cmd, step.base_command):
            digest.update(numbers.tobytes())
    print(plant, digest.hexdigest())
"""


def digests(cwd: Path, **other: str | None) -> str:
    """Checksums of short runs, in a process with this environment."""
    changed = {name: value for name, value in other.items() if value is not None}
    kept = {name: value for name, value in os.environ.items() if name not in other}
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        cwd=cwd,
        env={**kept, "PYTHONPATH": str(PROJECT), **changed},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.slow
def test_results_do_not_depend_on_folders_time_zone_or_decimal_commas(
    tmp_path: Path,
) -> None:
    here, source, commas = tmp_path / "here", Path("/usr/lib/locale/C.utf8"), {}
    here.mkdir()
    if source.is_dir():  # a glibc locale as template
        numbers = shutil.copytree(source, tmp_path / COMMAS) / "LC_NUMERIC"
        numbers.write_bytes(numbers.read_bytes().replace(b".", b","))
        commas = {"LOCPATH": str(tmp_path), "LC_ALL": None}
    folders = {"HOME": "/nonexistent", "XDG_CACHE_HOME": None, "XDG_DATA_HOME": None}
    elsewhere = digests(here, TZ="Asia/Kathmandu", FILES="64", LANG="C", **folders, **commas)
    assert elsewhere == digests(PROJECT, TZ="UTC")
    assert list(here.iterdir()) == []


def test_robots_are_found_in_every_folder_of_a_list(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [tmp_path / "a", tmp_path / "b"]
    for number, folder in enumerate(folders):
        made = shutil.copytree(assets.ASSETS / "husky_panda", folder / f"mine_{number}")
        text = (made / "robot.toml").read_text(encoding="utf-8")
        (made / "robot.toml").write_text(
            text.replace('name = "husky_panda"', f'name = "{made.name}"', 1), encoding="utf-8"
        )
    monkeypatch.setenv("DBB_ROBOTS", os.pathsep.join(map(str, [*folders, tmp_path / "none"])))
    assert {"mine_0", "mine_1", "husky_panda"} <= set(assets.robot_names())
    assert [assets.is_own(name) for name in ("mine_1", "husky_panda")] == [True, False]
    assert assets.user_robots()[0] == folders[0]
    assert load_robot("mine_1").name == "mine_1"
    with pytest.raises(UnknownNameError, match=f"mine_2.*does not exist: {tmp_path}/none"):
        load_robot("mine_2")


def test_copied_folder_is_a_robot_with_the_name_of_the_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = shutil.copytree(assets.ASSETS / "husky_panda", tmp_path / "moved")
    urdf = made / "robot.urdf"
    urdf.write_text(f"{urdf.read_text(encoding='utf-8')}<!-- moved -->", encoding="utf-8")
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    assert load_robot("moved").name == "moved"
    assert assets.urdf_path(load_robot("moved")) == urdf
    assert "moved" in assets.robot_names()


@pytest.mark.parametrize(
    ("used", "hidden", "why"),
    [
        ("delivered", "a/tiago", "{}/a/tiago is not used, because a delivered robot has the same"),
        ("a/mine", "b/mine", "{0}/b/mine is not used, because the robot in {0}/a/mine has the"),
    ],
)
def test_a_folder_that_another_robot_hides_is_named(
    used: str, hidden: str, why: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    for each in {used, hidden} - {"delivered"}:
        shutil.copytree(assets.ASSETS / "tiago", tmp_path / each)
    name, why = Path(hidden).name, why.format(tmp_path)
    listed = f"{assets.ASSETS}:{tmp_path / 'a'}:{tmp_path / 'b'}:{tmp_path / 'a'}"
    monkeypatch.setenv("DBB_ROBOTS", listed)
    assert assets.hidden_robot(name).startswith(why)
    assert [assets.hidden_robot(each) for each in ("husky_panda", "nothing")] == ["", ""]
    main(["robots"])
    assert capsys.readouterr().err.count(why) == 1
    said: list[str] = []
    monkeypatch.setattr("app.cli.options._log.warning", lambda _, text: said.append(text))
    configured(name, None)  # as for all commands with parameters
    assert [text.startswith(why) for text in said] == [True]


def test_a_robot_in_a_folder_that_the_user_cannot_enter_is_listed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "closed").mkdir()
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    assert "closed" not in assets.robot_names()
    monkeypatch.setattr(os, "access", lambda path, _: path != tmp_path / "closed")
    assert "closed" in assets.robot_names()
    assert assets.robot_folder("closed") == tmp_path / "closed"


@pytest.mark.parametrize("backend", ["nosuch", "module://matplotlib_inline.backend_inline"])
def test_backend_of_a_notebook_does_not_disturb_a_command(backend: str) -> None:
    code = (
        "import os, app.studies.pulls.parameters\nfrom app.cli import main\n"
        f"assert os.environ['MPLBACKEND'] == {backend!r}\n"  # a program that imports `app`
        "main(['--version'])\nimport matplotlib\nprint(matplotlib.get_backend())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=PROJECT,
        env={**os.environ, "MPLBACKEND": backend},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout.splitlines()[1:] == ["agg"], done.stderr


@pytest.mark.parametrize(
    ("listed", "named"),
    [
        ("~nobody-here/robots", "does not exist: ~nobody-here/robots"),
        ("{}/robot:/none", "the folder of a robot, {}/robot: name the folder around it"),
        ("{}/file", "a file, not a folder: {}/file"),
        ("{}/loop", "does not exist: {}/loop"),
        ('"{}"', 'does not exist: "{}"'),
    ],
    ids=["user", "robot", "file", "loop", "quotes"],
)
def test_error_names_a_folder_that_cannot_contain_robots(
    listed: str, named: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(assets.ASSETS / "husky_panda", tmp_path / "robot")
    (tmp_path / "file").touch()
    (tmp_path / "loop").symlink_to("loop")
    monkeypatch.setenv("DBB_ROBOTS", listed.replace(":", os.pathsep).format(tmp_path))
    with pytest.raises(UnknownNameError, match=re.escape(named.format(tmp_path))):
        load_robot("mine")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not read XDG_DATA_HOME")
@pytest.mark.parametrize("listed", ["", ":/elsewhere", "/elsewhere:"])
def test_empty_entry_means_the_default_folder(
    listed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    monkeypatch.setenv("DBB_ROBOTS", listed.replace(":", os.pathsep))
    assert any(folder.is_relative_to(tmp_path) for folder in assets.user_robots())


def test_folders_are_absolute_without_a_home(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """`~` is not expanded for an unknown user, as in a container."""
    monkeypatch.setattr(os.path, "expanduser", lambda path: path)
    for name in ("HOME", "XDG_CACHE_HOME", "XDG_DATA_HOME", "DBB_ROBOTS"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.chdir(tmp_path)
    folders = [assets.cache_folder(), *system.cache_folders(), *assets.user_robots()]
    assert all(folder.is_absolute() for folder in folders)


EDITORS = {
    "Notepad": lambda text: codecs.BOM_UTF8 + text.replace("\n", "\r\n").encode(),
    "Unicode text of Windows": lambda text: text.replace("\n", "\r\n").encode("utf-16"),
    "big-endian": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
    "old Mac": lambda text: text.replace("\n", "\r").encode(),
}


@pytest.mark.parametrize("edit", EDITORS.values(), ids=EDITORS)
def test_files_survive_encodings_and_line_ends_of_editors(edit, tmp_path: Path) -> None:
    config = 'name = "grün"\n[border]\nd_b = 0.2 # [m]\n'
    assert decode_config(edit(config)).config.border.d_b == 0.2
    source = assets.ASSETS / "husky_panda" / "robot.toml"
    (tmp_path / "robot.toml").write_bytes(edit(source.read_text(encoding="utf-8")))
    assert load_description(tmp_path / "robot.toml") == load_description(source)
    log = tmp_path / "log.csv"
    write_trace(log, trace_of(random_snapshots(3, 4)))
    before = read_trace(log)
    log.write_bytes(edit(log.read_text(encoding="utf-8")))
    after = read_trace(log)
    assert np.array_equal(after.table, before.table, equal_nan=True)


@pytest.mark.parametrize("mark", [";", "\t"])
def test_log_survives_a_spreadsheet(tmp_path: Path, mark: str) -> None:
    """With decimal commas, and empty rows and columns at the ends."""
    snapshots = [replace(each, pulls=(), ghosts=(), scores=()) for each in random_snapshots(3, 4)]
    log = tmp_path / "log.csv"
    write_trace(log, trace_of(snapshots))
    before = read_trace(log)
    head, *rows = log.read_text(encoding="utf-8").splitlines()
    cells = [next(csv.reader([row])) for row in rows]
    swapped = [
        [x.replace(".", ",") if re.fullmatch(r"[-\d.e+]+", x) else x for x in row] for row in cells
    ]
    saved = tmp_path / "LOG.CSV"
    with saved.open("w", encoding="utf-16", newline="") as file:
        file.write(f"{head}{3 * mark}\r\n")
        csv.writer(file, delimiter=mark).writerows([*row, "", ""] for row in swapped)
        file.write(f"{len(swapped[0]) * mark}\r\n")
    after = read_trace(saved)
    assert np.array_equal(after.table, before.table, equal_nan=True)


@pytest.mark.parametrize(
    ("content", "named"),
    [
        (b"[border]\nd_b = 0,2\n", "'d_b = 0,2'; '= 0,2' has a decimal comma"),
        ("name = “soft”\n".encode(), "'name = “soft”'; '“' is a typographic quote"),
        ("[border]\nd_b =\u00a00.2\n".encode(), "is a special space"),
        (b'name = "soft\xe2\x80\x9d\n', "is a typographic quote"),
        ("[border]\nd_b = 2e−1\n".encode(), "typographic minus"),
        ("[border]\nd_b = −0.2\n".encode(), "typographic minus"),
        ('name = "grün"\n'.encode("latin-1"), "not UTF-8 in line 1; save the file as UTF-8"),
        (b"\xff\xfea\x00\n\x00b", "not UTF-16 in line 2; save the file as UTF-8"),
        (b"[border]\nd_b = 1.234,5e-1\n", "has a decimal comma"),
        ("[border]\nd_b = 0.2\u200b\n".encode(), r"'d_b = 0.2\u200b'; '\u200b' is a special space"),
        (b"[border]\nd_b = 0.2;\n", "(at line 2, column 10): 'd_b = 0.2;'"),
        (b'[border]\nd_b = "0.2"\n', "a number without quotes (was '0.2')"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a Git LFS pointer"),
        (b"\x1f\x8b\x08\x00", "an archive; unpack it"),
    ],
)
def test_error_names_the_typing_mistake(content: bytes, named: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(named)):
        decode_config(content)


@pytest.mark.parametrize("wrong", ["0.15 m", ".15", "0.15\nd_b = 0.2", '"a − b" c', '"a" # −\n['])
def test_error_in_a_file_of_parameters_has_no_advice_about_other_places(wrong: str) -> None:
    content = save_config(Config()).replace("d_b = 0.15", f"d_b = {wrong}").encode()
    with pytest.raises(ConfigError, match="the file is not TOML") as error:
        decode_config(content)
    assert not re.search("typographic|has a|take away", str(error.value))


@pytest.mark.parametrize(
    ("wrong", "advice"),
    [
        ('"seed": 0,\n}', "take away the comma"),
        ('"seed": 0,\n"ver', ""),
        ('"seed": 0,\n “version”: "1"}', "is a typographic quote"),
        ('"duration": 0,2,\n"seed": 0}', "has a decimal comma"),
        ('"name": "a − b",\n"start": [0,1', ""),
    ],
)
def test_error_in_a_case_has_advice_only_about_its_place(
    wrong: str, advice: str, tmp_path: Path
) -> None:
    (tmp_path / "c.json").write_text(f'{{"dbb_case": 1,\n{wrong}', encoding="utf-8")
    with pytest.raises(CaseError, match="it is not JSON") as error:
        read_case(tmp_path / "c.json")
    given = re.findall(
        "take away the comma|is a typographic quote|has a [a-z]+ comma|minus", str(error.value)
    )
    assert given == [advice] * bool(advice)


READERS = {
    "a.toml": read_config,
    "a.json": read_case,
    "a.csv": read_trace,
    "a.parquet": read_trace,
    "robot.toml": load_description,
}


@pytest.mark.parametrize("name", READERS)
def test_pipe_in_place_of_a_file_is_refused(name: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / name)
    # Without the refusal, the reader would wait for ever: this writer ends that wait.
    writer = threading.Thread(target=lambda: (tmp_path / name).open("wb").close(), daemon=True)
    writer.start()
    with pytest.raises(DbbError, match=f"{name}: .*it is a device or a pipe; name a file"):
        READERS[name](tmp_path / name)
    end = os.open(tmp_path / name, os.O_RDONLY | os.O_NONBLOCK)
    writer.join()
    os.close(end)


def test_trailing_comma_is_named(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text('{"dbb_case": 1,\n}\n')
    with pytest.raises(CaseError, match="take away the comma"):
        read_case(tmp_path / "c.json")


def test_error_explains_a_first_line_changed_by_a_spreadsheet(tmp_path: Path) -> None:
    log = tmp_path / "log.csv"
    write_trace(log, trace_of(random_snapshots(3, 4)))
    text = log.read_text(encoding="utf-8")
    log.write_text('"' + text.replace("\n", '"\n', 1), encoding="utf-8")
    with pytest.raises(LogError, match="a spreadsheet has probably changed"):
        read_trace(log)
