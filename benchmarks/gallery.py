"""Robots that nobody tuned: `python -m benchmarks.gallery --robots all|NAME,... [--quick]`.

Each is made by `dbb new-robot` with options alone and then checked by `dbb check-robot`. A row is
kept in a file as soon as it is there, so that the same call goes on where it was ended.
"""

from __future__ import annotations

import json as json_module
import tempfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import tyro

from app.border.config import QUICK, SamplingConfig
from app.cli.common import say
from app.errors import DbbError, UnknownNameError
from app.onboarding.check import check_robot
from app.onboarding.new_robot import NewRobot, compiled, finish
from app.onboarding.request import Request, check_request

_DATA = "package://example-robot-data/robots"
_RTB = "package://rtbdata/xacro"
_STRETCH = "package://stretch_urdf"
_MODULES = {"stretch_urdf": "hello-robot-stretch-urdf", "rtbdata": "rtb-data"}


def _package(name: str, folder: str) -> tuple[str, ...]:
    """`--package` of a ROS package in rtb-data under another name, if that is installed."""
    found = find_spec("rtbdata")
    if found is None or found.origin is None:
        return ()
    return (f"{name}={Path(found.origin).parent / 'xacro' / folder}",)


def _on(base: str, arm: str, tip: str, *, at: tuple[float, float, float], **more: Any) -> Any:
    """A base with an arm of another file."""
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
_TIAGO, _STRETCH_HAND = f"{_DATA}/tiago_description/robots", "link_grasp_center"
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
        _STRETCH_HAND,
    ),
    "stretch_re2": _of(
        f"{_STRETCH}/RE2V0/stretch_description_RE2V0_eoa_wrist_dw3_tool_sg3.urdf",
        "base_link",
        "link_gripper_s3_body",
    ),
    "stretch_se3": _of(
        f"{_STRETCH}/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf",
        "base_link",
        "link_gripper_s3_body",
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
    "racecar_wx250s": _on("racecar", *_WX, at=(0.2, 0.0, 0.2)),
}
"""What is given to `dbb new-robot` beside `--out`, by the robot's name."""


def main(
    robots: str = "all",
    file: Path = Path("out/gallery.json"),
    quick: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    again: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Make and check robots.

    Args:
        robots: Their names with commas, or all.
        file: Where the rows are kept.
        quick: With a coarser border.
        again: Those that the file has, too.
        json: Print the rows that were asked for as one JSON object.
    """
    names = list(ROBOTS) if robots == "all" else robots.split(",")
    for name in names:
        if name not in ROBOTS:
            raise SystemExit(str(UnknownNameError("robot of the gallery", name, ROBOTS)))
    rows = json_module.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for name in names:
        if again or name not in rows or rows[name]["quick"] != quick:
            say(name)
            rows[name] = {"quick": quick, **outcome(name, QUICK if quick else None)}
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(".part")
            part.write_text(json_module.dumps(rows, indent=1), encoding="utf-8")
            part.replace(file)
    asked = {name: rows[name] for name in names}
    if json:
        print(json_module.dumps(asked))
        return
    for name, row in asked.items():
        print(f"{name:18} {row['verdict']:8} {row['elapsed_s']:5.0f} s  {row.get('refusal', '')}")


def outcome(name: str, sampling: SamplingConfig | None) -> dict[str, Any]:
    """The row of a robot: made and checked, or the reason why not."""
    given, begin = ROBOTS[name], perf_counter()
    processes = None if sampling is None else 1  # a coarse one takes less than to start others
    used = f"{given['urdf']} {given.get('arm_urdf', '')}"
    for module, package in _MODULES.items():
        if f"//{module}/" in used and find_spec(module) is None:
            return _refused(f"the package {package} is not installed", begin)
    with tempfile.TemporaryDirectory() as folder:
        request = Request(**given, out=Path(folder) / name)
        try:
            check_request(request)
            made, data = finish(request, tell=say, sampling=sampling, processes=processes)
        except DbbError as error:
            return _refused(str(error), begin)
        made_in, points = perf_counter() - begin, {n: len(c) for n, c in data.clouds.items()}
        description = compiled(made.content, request.out / "robot.urdf").description
        checks = list(check_robot(description, tell=say, sampling=sampling, processes=processes))
    bad = [row.name for row in checks if row.outcome in ("failed", "nothing to show")]
    return {
        "verdict": "failed" if bad else "passed",
        "elapsed_s": made_in,
        "checked_in_s": perf_counter() - begin - made_in,
        **_figures(made),
        "border_points": points,
        "checks": {row.name: {"outcome": row.outcome, "text": row.text} for row in checks},
    }


def _refused(why: str, begin: float) -> dict[str, Any]:
    return {"verdict": "refused", "elapsed_s": perf_counter() - begin, "refusal": why}


def _figures(made: NewRobot) -> Mapping[str, Any]:
    """What was made."""
    return {
        "pairs": [pair.name for pair in made.pairs.all],
        "bodies_over_hulls": {b.name: [fit.over_cover for fit in b.fits] for b in made.bodies},
        "unseen_share": made.unseen.share,
        "ready_pose": made.ready.q_m.tolist(),
        "lines": sorted(made.places),
        "warnings": made.warnings,
    }


if __name__ == "__main__":
    tyro.cli(main)
