"""Replay: run a scenario, store its log, and make a page that replays it without a server.

`dbb run --log` and `dbb replay` do the same.
Run it: python examples/replay.py
"""

from pathlib import Path

from app import Config, RobotModel, load_border_data, load_robot
from app.dashboard.export import Look
from app.dashboard.export.offscreen import replay_html
from app.simulation.run import run_scenario
from app.simulation.scenarios import scenario_by_name
from app.simulation.trace.log_file import read_trace, write_trace


def main(folder: Path = Path("out/examples"), duration: float = 4.0) -> Path:
    """Run the scenario, write the log and the page; returns the HTML file."""
    model = RobotModel(load_robot("husky_panda"))
    data = load_border_data(model)
    scenario = scenario_by_name("guiding-front").changed(duration=duration)
    run = run_scenario(model, data, scenario, Config(), drawn=True)
    folder.mkdir(parents=True, exist_ok=True)
    write_trace(folder / "front.parquet", run.trace)  # or .csv

    log = read_trace(folder / "front.parquet")
    page = folder / "front.html"
    page.write_text(replay_html(log, model, data.clouds, Look()), encoding="utf-8")
    return page


if __name__ == "__main__":
    print(main())
