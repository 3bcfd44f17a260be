"""Read the table of a control step: each quantity with its symbol, unit, frame and value.

Run it: python examples/step_table.py
"""

import numpy as np

from app import ControlLoop, ControlStep, RobotModel, load_robot
from app.control.quantities import QUANTITIES
from app.robot.state import at_rest

SHOWN = ("p_ee", "d", "beta", "f", "a_base_des", "a_base_cmd", "u_cmd", "solved")


def main() -> ControlStep:
    """Take one step at rest, and print some quantities; returns a copy of all of them."""
    model = RobotModel(load_robot("husky_panda"))
    loop = ControlLoop(model)
    ready = np.array(model.description.arm.ready_position)
    step = loop.step(at_rest(model, ready)).step
    about = {quantity.name: quantity for quantity in QUANTITIES}
    for name in SHOWN:
        q = about[name]
        value = np.array2string(getattr(step, name), precision=3, suppress_small=True)
        print(f"{name} {q.symbol} [{q.unit}] {q.frame}: {q.meaning}\n    {value}")
    for pair, distance in zip(step.pairs, step.d, strict=False):
        print(f"{pair.name}: {distance:.3f} m")
    return step.copy()  # the next step overwrites the original


if __name__ == "__main__":
    main()
