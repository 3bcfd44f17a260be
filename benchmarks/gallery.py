"""Robots without manual tuning: `python -m benchmarks.gallery --robots all|NAME,... [--quick]`.

`dbb new-robot` creates each robot from its options alone, and `dbb check-robot` checks it. Both run
in separate processes, so a crash becomes a row of the table. With `--quick` and without `--json`,
the rows are those of the documentation's table: each finished row is stored, and the next call
measures only the missing rows.
"""

from __future__ import annotations

import json as json_module
import os
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Any

import tyro

from app.cli.common import say
from app.cli.options import Flag, Json
from app.errors import UnknownNameError, check_name
from app.onboarding.request import option

_PROJECT = Path(__file__).resolve().parent.parent
FOLDER = _PROJECT / "out" / "gallery"
"""Folder of the robots, each with its report."""
_DATA = "package://example-robot-data/robots"
_RTB = "package://rtbdata/xacro"
_STRETCH = "package://stretch_urdf"


def _package(name: str, folder: str) -> tuple[str, ...]:
    """The option `--package` for a ROS package whose folder in rtb-data has another name."""
    found = find_spec("rtbdata")
    if found is None or found.origin is None:
        return ()
    return (f"{name}={Path(found.origin).parent / 'xacro' / folder}",)


def _on(base: str, arm: str, tip: str, *, at: tuple[float, float, float], **more: Any) -> Any:
    """Options for a base with an arm of another URDF, mounted at `at` (3,) [m]."""
    bases = {
        "husky": {"urdf": "robot_assets/bases/husky.urdf", "base": "base_link", "half_track": 0.51},
        "racecar": {
            "urdf": "robot_assets/bases/racecar.urdf",
            "base": "base_link",
            "kind": "car-like",
        },
        "ridgeback": {
            "urdf": f"{_RTB}/clearpath_ridgeback_description/urdf/ridgeback.urdf.xacro",
            "base": "base_link",
            "kind": "holonomic",
            "package": _package("ridgeback_description", "clearpath_ridgeback_description"),
        },
    }
    return {**bases[base], "arm_urdf": arm, "tip": tip, "mount_xyz": at, **more}


def _ur(size: int) -> tuple[str, str]:
    return f"{_DATA}/ur_description/urdf/ur{size}_robot.urdf", "tool0"


def _of(urdf: str, base: str, tip: str, **more: Any) -> dict[str, Any]:
    return {"urdf": urdf, "base": base, "tip": tip, **more}


_PANDA = "robot_assets/bases/panda.urdf", "panda_hand"
_WX = f"{_RTB}/trossen_descriptions/urdf/wx250s.urdf.xacro", "/ee_gripper_link"
_IIWA = f"{_RTB}/kuka_description/kuka_lbr_iiwa/urdf/lbr_iiwa_14_r820.xacro", "tool0"
_FRONT, _BACK, _DECK = (0.3, 0.0, 0.256), (-0.3, 0.0, 0.256), (0.2, 0.0, 0.3)
_TIAGO, _STRETCH_TIP = f"{_DATA}/tiago_description/robots", "link_grasp_center"
_FRANKIE = f"{_RTB}/qut_frankie_description/robots"
_ON_FRANKIE = {"tip_xyz": (0.0, 0.0, 0.1034), "assume_inertia": True}
ROBOTS: dict[str, dict[str, Any]] = {
    "husky_ur3": _on("husky", *_ur(3), at=_FRONT),
    "husky_ur5": _on("husky", *_ur(5), at=_FRONT),
    "husky_ur10": _on("husky", *_ur(10), at=_FRONT),
    "husky_ur10_back": _on("husky", *_ur(10), at=_BACK),
    "husky_panda": _on("husky", *_PANDA, at=_FRONT),
    "husky_xarm7": _on("husky", f"{_DATA}/xarm_description/urdf/xarm7.urdf", "link7", at=_FRONT),
    "husky_iiwa14": _on(
        "husky",
        *_IIWA,
        at=_FRONT,
        assume_inertia=True,
        package=_package("kuka_lbr_iiwa_support", "kuka_description/kuka_lbr_iiwa"),
    ),
    "husky_kinova": _on(
        "husky",
        f"{_DATA}/kinova_description/robots/kinova.urdf",
        "j2s6s200_end_effector",
        at=_FRONT,
    ),
    "husky_z1": _on("husky", f"{_DATA}/z1_description/urdf/z1.urdf", "link06", at=_FRONT),
    "husky_wx250s": _on("husky", *_WX, at=_FRONT),
    "ridgeback_ur5": _on("ridgeback", *_ur(5), at=_DECK),
    "ridgeback_panda": _on("ridgeback", *_PANDA, at=_DECK),
    "stretch_re1": _of(
        f"{_STRETCH}/RE1V0/stretch_description_RE1V0_tool_stretch_gripper.urdf",
        "base_link",
        _STRETCH_TIP,
    ),
    "stretch_re2": _of(
        f"{_STRETCH}/RE2V0/stretch_description_RE2V0_eoa_wrist_dw3_tool_sg3.urdf",
        "base_link",
        _STRETCH_TIP,
    ),
    "stretch_se3": _of(
        f"{_STRETCH}/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf",
        "base_link",
        _STRETCH_TIP,
    ),
    "tiago": _of(f"{_TIAGO}/tiago_no_hand.urdf", "base_footprint", "wrist_ft_tool_link"),
    "tiago_hand": _of(f"{_TIAGO}/tiago.urdf", "base_footprint", "arm_tool_link"),
    "tiago_dual": _of(f"{_TIAGO}/tiago_dual.urdf", "base_footprint", "arm_left_tool_link"),
    "tiago_pro": _of(
        f"{_DATA}/tiago_pro_description/robots/tiago_pro.urdf",
        "base_footprint",
        "arm_right_tool_link",
        kind="holonomic",
    ),
    "pr2": _of(
        f"{_DATA}/pr2_description/urdf/pr2.urdf",
        "base_footprint",
        "r_gripper_tool_frame",
        kind="holonomic",
    ),
    "frankie": _of(
        f"{_FRANKIE}/frankie_arm_hand.urdf.xacro",
        "panda_base_arm",
        "frankie_hand",
        wheel_radius=0.1,
        half_track=0.2,
        **_ON_FRANKIE,
    ),
    "frankie_omni": _of(
        f"{_FRANKIE}/frankieOmni_arm_hand.urdf.xacro",
        "panda_base_arm",
        "frankie_hand",
        kind="holonomic",
        **_ON_FRANKIE,
    ),
    "racecar_wx250s": _on("racecar", *_WX, at=(0.4, 0.0, 0.35)),
}
"""Options of `dbb new-robot` besides `--out`, by the robot's name."""


def main(
    robots: str = "all",
    quick: Flag = False,
    json: Json = False,
) -> None:
    """Create and check robots.

    Args:
        robots: Names of the robots, separated by commas, or all.
        quick: Sample a coarse border, as for the documentation's table. Without --json, stored rows
            of this commit are used again, and missing rows are measured and stored.
        json: Print only one JSON object.
    """
    names = list(ROBOTS) if robots == "all" else robots.split(",")
    try:
        for name in names:
            check_name("robot of the gallery", name, ROBOTS)
    except UnknownNameError as error:
        sys.exit(str(error))
    if quick and not json:
        # Imported here: only this case uses the stored tables.
        from tools.results import figures, measure

        if not measure("gallery", again=False, only=names):
            sys.exit(1)
        rows = figures("gallery")
    else:
        rows = {name: outcome(name, quick) for name in names}
    if json:
        print(json_module.dumps(rows))
        return
    for name in names:
        row = rows[name]
        print(f"{name:18} {row['verdict']:8} {row['cpu_s']:5.0f} s  {row.get('refusal', '')}")


def dbb(*words: str) -> tuple[dict[str, Any] | None, dict[str, Any]]:
    """Run a command of dbb with `--json`, with the robots in `FOLDER`.

    Returns:
        The output of the command or None, and a record: its duration, the processor time of all
            cores, and, without an output, the verdict `refused` or `crashed` and the last message.
    """
    begin, before = perf_counter(), _cpu_seconds()
    done = subprocess.run(
        [sys.executable, "-m", "app", *words, "--json"],
        cwd=_PROJECT,
        capture_output=True,
        text=True,
        env={**os.environ, "DBB_ROBOTS": str(FOLDER)},
    )
    took = {"elapsed_s": perf_counter() - begin, "cpu_s": _cpu_seconds() - before}
    code, said = done.returncode, done.stderr.strip().splitlines() or ["without a word"]
    if code in (0, 1) and done.stdout:
        return json_module.loads(done.stdout), took
    if code < 0:
        said.append(f"dbb {words[0]} ended by {signal.Signals(-code).name} at: {said[-1]}")
    verdict = "refused" if code == 2 else "crashed"
    return None, took | {"verdict": verdict, "refusal": said[-1].removeprefix("dbb: error: ")}


def _cpu_seconds() -> float:
    """[s] processor time of all ended child processes."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def words_of(given: Mapping[str, Any]) -> Iterator[str]:
    """Arguments of `dbb new-robot` for the values `given` of fields of a `Request`."""
    yield given["urdf"]
    for field, value in given.items():
        if field == "urdf" or value == ():
            continue
        yield option(field)
        if value is not True:
            yield from map(str, value if isinstance(value, tuple) else (value,))


def outcome(name: str, quick: bool) -> dict[str, Any]:
    """The row of a robot: its results, or the reason why it was not created or not checked."""
    say(name)
    how = ["--quick"] if quick else []
    own = f"new_{name}"  # a delivered robot has precedence over a robot with the same name
    shutil.rmtree(FOLDER / own, ignore_errors=True)
    made, row = dbb("new-robot", *words_of(ROBOTS[name]), "--out", str(FOLDER / own), *how)
    if made is None:
        return row
    found, took = dbb("check-robot", own, *how)
    row |= {key: made[key] for key in _FIGURES}
    if found is None:
        return took | row
    checks = {each.pop("name"): each for each in found["checks"]}
    return row | {
        "verdict": verdict(checks),
        "check_cpu_s": took["cpu_s"],
        "checks": checks,
    }


def verdict(checks: Mapping[str, Mapping[str, Any]]) -> str:
    """The verdict on all checks, the first of these that applies: failed, nothing to show, passed,
    warned. The failed row `guiding` alone means "nothing to show".
    """
    ends = {name: each["outcome"] for name, each in checks.items()}
    if "failed" in (outcome for name, outcome in ends.items() if name != "guiding"):
        return "failed"
    if "guiding" in ends or "nothing to show" in ends.values():
        return "nothing to show"
    return "passed" if "passed" in (ends[name] for name in ends if "guiding-" in name) else "warned"


_FIGURES = ("pairs", "ready_position", "lines", "border_points", "warnings")
"""Keys of the output of `dbb new-robot`."""


if __name__ == "__main__":
    tyro.cli(main)
