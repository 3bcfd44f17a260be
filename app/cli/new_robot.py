"""`dbb new-robot`: a description, a border and a report from a URDF."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from app.cli.common import print_json, rounded_text, say
from app.cli.options import Json
from app.cli.records import Given, from_record
from app.onboarding.request import Request

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.onboarding.new_robot import NewRobot

_NAMES = {"d_b": "buffer_distance"}


def new_robot(
    request: Annotated[
        Given, from_record(Request, leave=("source",), names=_NAMES, positional="urdf")
    ],
    json: Json = False,
) -> None:
    """Make a robot's description and border from its URDF or xacro.

    Finds the wheels, groups the arm's links into bodies, fits convex shapes to them, samples the
    pairs, chooses a ready pose, counts the reachability, and writes each number with its source.
    Nothing is written unless all of it is.
    """
    asked = Request(**request)
    # Imported here: matplotlib, scipy and trimesh would make every other command start later.
    from app.onboarding.request import check_request

    check_request(asked)
    from app.onboarding.write.make import finish

    begin = perf_counter()
    steps = _Steps()
    robot, data = finish(asked, tell=steps.say, on_progress=steps.share, progress=False)
    result = _figures(robot, data) | {"elapsed_s": perf_counter() - begin}
    if json:
        print_json(result)
    else:
        _print(result)


def _print(made: dict[str, Any]) -> None:
    """What was made, and what to do with it."""
    from app.robot.assets import robot_folder

    name, folder = made["robot"], made["folder"]
    print(f"{name}: {folder}/robot.toml and {folder}/report.html, in {made['elapsed_s']:.0f} s")
    geometry = (f"{key} {rounded_text(made[key])}" for key in _GEOMETRY if key in made)
    base = ", ".join([f"{made['base']}, {made['mass_kg']:.4g} kg", *geometry])
    bodies = (f"{body} ({', '.join(each['links'])})" for body, each in made["bodies"].items())
    rates = made["collision_rate"]
    pairs = ", ".join(f"{pair} ({rates[pair]:.1%} of all poses)" for pair in made["pairs"])
    reach = (
        f"{body} A {each['A_per_m2']:.4g} /m², B {each['B_m']:.3g} m, C {each['C']:.3g}"
        + ("" if each.get("r_squared") is None else f" (R² {each['r_squared']:.2f})")
        for body, each in made["reachability"].items()
    )
    for title, text in (
        ("base", base),
        ("arm", f"{made['arm_joints']} joints; {', '.join(bodies)}"),
        ("can collide", pairs or "nothing"),
        ("reachability", "; ".join(reach)),
    ):
        print(f"  {title:13} {text}")
    for warning in made["warnings"]:
        print(f"  warning: {warning}")
    print("next:")
    if robot_folder(name).resolve() != Path(folder).resolve():
        print(f"  export DBB_ROBOTS={Path(folder).resolve().parent}   so that dbb finds it")
    print(f"  open {folder}/report.html, and look whether the bodies hold the links")
    print(f"  dbb check-robot {name}")
    print(f"  dbb serve --robot {name}")


class _Steps:
    """Says what is being done, and every few seconds how far it is, on a terminal and off it."""

    def __init__(self) -> None:
        self._text, self._last = "", perf_counter()

    def say(self, text: str) -> None:
        """A new step."""
        self._text, self._last = text, perf_counter()
        say(text)

    def share(self, share: float) -> None:
        """Which share of the step is done, 0 to 1."""
        if perf_counter() - self._last > _EVERY:
            self._last = perf_counter()
            say(f"{self._text}: {share:.0%}")


_EVERY = 5.0  # [s] between two lines of one step
_GEOMETRY = ("wheel_radius_m", "half_track_m", "wheelbase_m", "steering_limit_rad")


def _figures(robot: NewRobot, data: BorderData) -> dict[str, Any]:
    base = robot.content["base"]
    return {
        "robot": robot.request.name,
        "folder": str(robot.request.out),
        "arm_joints": len(robot.parsed.arm.joints),
        "base": base["kind"],
        **{key: base[key] for key in _GEOMETRY if key in base},
        "mass_kg": base["mass_kg"],
        "bodies": {
            body.name: {
                "links": list(body.links),
                "shapes": [fit.shape.type for fit in body.fits],
                "over_cover": [fit.over_cover for fit in body.fits],
                "protrusion_m": max(fit.protrusion for fit in body.fits),
            }
            for body in robot.bodies
        },
        "pairs": [pair.name for pair in data.pairs.all],
        "collision_rate": data.pairs.rates,
        "least_distance_m": data.pairs.least_distance_m,
        "missed_collisions": robot.verdict.missed,
        "false_collisions": robot.verdict.false,
        "reachability": {
            name: {
                "A_per_m2": r.A,
                "B_m": r.B,
                "C": r.C,
                "counted": r.counted is not None,
                "r_squared": None if r.fit is None else r.fit.r_squared,
            }
            for name, r in robot.reach.items()
        },
        "ready_position": robot.ready.q_m.tolist(),
        "ready_clearance_m": robot.ready.clearance if data.pairs.all else None,
        "lines": {name: list(place.start) for name, place in robot.places.items()},
        "border_points": {name: len(cloud) for name, cloud in data.clouds.items()},
        "warnings": robot.warnings,
    }
