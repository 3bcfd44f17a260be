"""`dbb robots`: which robots there are."""

from __future__ import annotations

from app.cli.common import print_json
from app.cli.options import Json


def robots(json: Json = False) -> None:
    """List the robots that have a description."""
    # Imported here: it needs the readers of descriptions.
    from app.robot.assets import load_robot, robot_names

    found = [load_robot(name) for name in robot_names()]
    if json:
        print_json(
            {
                "robots": [
                    {
                        "name": d.name,
                        "title": d.title,
                        "base": d.base.kind,
                        "arm_joints": len(d.arm.joints),
                        "bodies": [b.name for b in d.bodies],
                    }
                    for d in found
                ]
            }
        )
        return
    for d in found:
        print(f"{d.name:20} {d.title}: {d.base.kind} base, arm of {len(d.arm.joints)} joints")
