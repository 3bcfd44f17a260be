"""A static web site: `make site` or `python -m tools.site [--out out/site]`.

The site has the documentation and, for the paper's robot, replays of every scenario with every
controller, the border for several d_b, and the polar maps of a sweep.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, get_args

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from rich.progress import track

from app.border.cache import BorderData
from app.cli.common import load_robot_and_border
from app.cli.main import main as dbb
from app.config import BorderConfig, Config
from app.control import CONTROLLERS
from app.dashboard.export import Layer, Look
from app.dashboard.export.offscreen import (
    OffscreenScene,
    RecordedLoop,
    own_server,
    replay_html,
)
from app.dashboard.markup import minus
from app.dashboard.phrases import spoken
from app.dashboard.scene.camera import first_view
from app.errors import DbbError
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import filmed, run_scenario
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.scenarios.leading import Scenario
from app.simulation.trace.metrics import touches, verdict
from app.simulation.trace.snapshot import Snapshot
from app.system import write_whole

PROJECT = Path(__file__).resolve().parent.parent
ROBOT = "husky_panda"
"""The paper's robot; its meshes have BSD and Apache licences."""
LARGEST = 3e6
"""[bytes] largest accepted size of a page; such a page opens without a delay."""
DISTANCES = tuple(round(0.01 * k, 2) for k in range(6, 25, 3))
"""[m] buffer distances of the border's pages."""
HOLD = 1.0  # [s] display time of each d_b


class Played(NamedTuple):
    """A run with its page.

    Attributes:
        page: Address of the page.
        verdict: The result in words.
        result: The word "contact" if the arm touched the base, itself or the floor; otherwise the
            smallest distance between arm and base.
        loud: Whether there was such a contact, or an overlap of arm and base.
    """

    page: str
    verdict: str
    result: str
    loud: bool


class Bordered(NamedTuple):
    """The page of a border, the displayed name of its pair, and the quantity of its colours."""

    page: str
    pair: str
    layer: str


def make_site(
    out: Path,
    scenarios: Sequence[Scenario],
    controllers: Sequence[str],
    layers: Sequence[Layer],
) -> None:
    """Make replays, borders and the page that links them; it links `docs` and `maps` if they exist.

    Args:
        out: An existing folder.
        scenarios: The scenarios, one row of replays for each.
        controllers: Names of the controllers, one column for each.
        layers: Quantities that colour the borders.

    Raises:
        DbbError: A page is larger than `LARGEST`.
    """
    model, data = load_robot_and_border(ROBOT)
    asked = [(scenario, name) for scenario in scenarios for name in controllers]
    played = {
        (scenario.name, name): _replay(out, model, data, scenario, name)
        for scenario, name in track(asked, "replays")
    }
    looks: list[tuple[str, Layer]] = [(pair, layer) for pair in data.clouds for layer in layers]
    snapshots = [_at_rest(model, data, k * HOLD, d_b) for k, d_b in enumerate(DISTANCES)]
    borders = [
        _border(out, model, data, snapshots, pair, layer) for pair, layer in track(looks, "borders")
    ]
    shutil.copy(PROJECT / "docs/pictures/pull.webp", out / "pull.webp")
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined
    )
    page = environment.get_template("site.html.j2").render(
        scenarios=scenarios,
        controllers=controllers,
        played=played,
        borders=borders,
        maps=sorted(path.relative_to(out).as_posix() for path in out.glob("maps/*.png")),
        docs=(out / "docs/index.html").exists(),
    )
    write_whole(out / "index.html", page)


def _replay(
    out: Path, model: RobotModel, data: BorderData, scenario: Scenario, controller: str
) -> Played:
    result = run_scenario(model, data, scenario, Config(), controller=controller, drawn=True)
    name = f"replays/{scenario.name}-{controller}.html"
    look = Look(view=first_view(result.trace.snapshots[0]))
    _write(out / name, replay_html(result.trace, model, data.clouds, look))
    figures = result.figures
    near = [1e3 * figures["min_distance_m"][pair] for pair in result.trace.meta.mobile_pairs]
    least = minus(f"{min(near):.0f} mm") if near else ""
    loud = bool(touches(figures)) or min(near, default=0.0) < 0.0
    return Played(name, verdict(figures), "contact" if touches(figures) else least, loud)


def _at_rest(model: RobotModel, data: BorderData, t: float, d_b: float) -> Snapshot:
    """The robot before a pull, at the time t [s], with the buffer distance d_b [m]."""
    scenario = scenario_of(model.description, "guiding-front")
    config = Config(border=BorderConfig(d_b=d_b))
    run = RunSpec(model.description.name, scenario, config, physics="kinematic")
    return replace(filmed(run, model, data, [0.0])[0], t=t)


def _border(
    out: Path,
    model: RobotModel,
    data: BorderData,
    snapshots: Sequence[Snapshot],
    pair: str,
    layer: Layer,
) -> Bordered:
    """Make the page of a pair's border, whose timeline changes d_b instead of the time."""
    with own_server() as server:
        look = Look(layer=layer, pair=pair)
        scene = OffscreenScene(server, RecordedLoop(snapshots), model, data.clouds, look)
        scene.look(snapshots[:1])
        recording = server.get_scene_serializer()
        for snapshot in snapshots:
            scene.draw(snapshot.t)
            text = f"d_b = {snapshot.config.border.d_b:.2f} m"
            server.scene.add_label("/d_b", text, position=(1.0, 0.0, 0.05))
            recording.insert_sleep(HOLD)
        name = f"border/{pair}-{layer}.html"
        _write(out / name, recording.as_html(dark_mode=look.dark))
    return Bordered(name, spoken(pair, model.body_names), layer)


def _write(path: Path, page: str) -> None:
    size = len(page.encode())
    if size > LARGEST:
        raise DbbError(f"{path.name} has {size / 1e6:.1f} MB; a page may have {LARGEST / 1e6:g}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, page)


def main() -> None:
    """Make the whole site."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=PROJECT / "out/site")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    sphinx = [sys.executable, "-m", "sphinx", "-n", "-W", "-q", "--keep-going"]
    subprocess.run([*sphinx, str(PROJECT / "docs"), str(out / "docs")], check=True)
    dbb(["sweep", "--controller", "dbb,none", "--step", "15", "--out", str(out / "maps")])
    description = load_robot(ROBOT)
    scenarios = [scenario_of(description, name) for name in SCENARIOS]
    make_site(out, scenarios, CONTROLLERS, [each for each in get_args(Layer) if each != "none"])
    (out / ".nojekyll").touch()
    print(out / "index.html")


if __name__ == "__main__":
    main()
