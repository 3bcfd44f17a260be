"""Plot: distances and activations of a run over time, with matplotlib.

`Trace.columns` lists all columns; their names end in the unit.
Run it: python examples/plot.py
"""

from pathlib import Path

import matplotlib.pyplot as plt

from app import Config, RobotModel, load_border_data, load_robot
from app.simulation.run import run_scenario
from app.simulation.scenarios import scenario_by_name


def main(file: Path = Path("out/examples/distances.png"), duration: float = 8.0) -> Path:
    """Run the scenario and draw the plot; returns the file of the picture."""
    model = RobotModel(load_robot("husky_panda"))
    scenario = scenario_by_name("guiding-lateral").changed(duration=duration)
    config = Config()
    trace = run_scenario(model, load_border_data(model), scenario, config).trace

    figure, (above, below) = plt.subplots(2, sharex=True, layout="constrained")
    for i, pair in enumerate(trace.meta.pairs):
        above.plot(trace.t, trace.distances[:, i], label=pair)
        below.plot(trace.t, trace.betas[:, i])
    above.axhline(config.border.d_b, color="grey", linestyle="--", label="$d_b$")
    above.set(ylabel="distance [m]")
    below.set(ylabel="activation β [-]", xlabel="time [s]")
    above.legend()
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file)
    plt.close(figure)
    return file


if __name__ == "__main__":
    print(main())
