"""The page as a whole: all layers and panels, and how a snapshot is drawn on them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import viser

from app.border.cloud import Cloud
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.border.score import ScoreField
from app.config import BorderConfig
from app.dashboard.acting_points import ActingPoints
from app.dashboard.border_cloud import BorderCloud
from app.dashboard.hand import Hand
from app.dashboard.legend import legend_html
from app.dashboard.notices import Notices
from app.dashboard.pair_lines import PairLines
from app.dashboard.panels.border import add_border_choice
from app.dashboard.panels.case import add_case_button
from app.dashboard.panels.run import RunPanel
from app.dashboard.panels.sweep import DEFAULT_FOLDER, SweepPanel
from app.dashboard.panels.tuning import BORDER_AND_FORCE, GAINS, MAIN, Tuning, TuningPanel
from app.dashboard.panels.view import ViewPanel
from app.dashboard.plots import Plots
from app.dashboard.robot import RobotScene
from app.dashboard.stage import Stage
from app.dashboard.view import View
from app.robot.model import RobotModel
from app.simulation.leading import Scenario
from app.simulation.loop import LoopHandle

Array = np.ndarray

PANEL_WIDTH = 330  # [px] of each of the two columns


class Page:
    """Builds the page; `draw` is called by one thread only."""

    def __init__(
        self,
        server: viser.ViserServer,
        loop: LoopHandle,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        case: Scenario | None = None,
        sweeps: Path = DEFAULT_FOLDER,
    ) -> None:
        self._server, self._loop, self._case = server, loop, case
        first = loop.latest()
        names = [pair.name for pair in first.pairs]
        mobile = [pair.name for pair in first.pairs if pair.mobile]
        self.view = View(pair=mobile[0])
        self.notices = Notices(server)
        self.tuning = Tuning(loop, first.config)
        self._shown: tuple[object, ...] = ()
        self._stage = Stage(server, model.description.title, dark=self.view.dark)
        self._robot = RobotScene(server, model)
        top = float(MobileBody(model).upper[2])
        borders = _Borders(model, clouds)
        self._border = BorderCloud(server, top, borders.points, borders.values)
        self._lines = PairLines(server, names)
        self._acting = ActingPoints(server, mobile)
        self.hand = Hand(server, loop, self.notices)
        self._build_panels(names, mobile, model.description.name, sweeps)
        server.on_client_connect(self._welcome)

    def draw(self, *, texts: bool) -> None:
        """Draw the newest snapshot.

        Args:
            texts: Whether panels, plots and labels are due too.
        """
        snapshot = self._loop.latest()
        # Selecting a border takes milliseconds: outside of `atomic`, which holds up all sending.
        if self._border.update(self.view, self.tuning.config.border):
            self._legend.content = legend_html(self._border.legend)
        new = self._loop.history(self._plots.last) if texts else []
        with self._server.atomic():
            self._apply_view()
            self._robot.update(snapshot)
            self._lines.update(snapshot, self.view, texts=texts)
            self._acting.update(snapshot, self.view, texts=texts)
            self.hand.update(snapshot, texts=texts)
            self._stage.follow(snapshot.base_pose[:2], on=self.view.follow)
            if texts:
                self._run.update(snapshot)
                self._plots.update(new, snapshot)
        if texts:
            self.sweep_panel.update()

    def close(self) -> None:
        """End what the page has started besides drawing."""
        self.sweep_panel.close()

    def fail(self, title: str, error: BaseException) -> None:
        """Show, for good and to later viewers too, that the simulation or the drawing has ended."""
        self._banner.content = (
            '<div style="margin:.5em .7em;padding:.5em .7em;border-radius:4px;background:#c92a2a;'
            f'color:white;font-size:.85em"><b>{title}</b><br>{_escape(error)}</div>'
        )
        self._banner.visible = True

    def _build_panels(self, names: list[str], mobile: list[str], robot: str, sweeps: Path) -> None:
        gui, notices = self._server.gui, self.notices
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._banner = gui.add_html("", visible=False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._run = RunPanel(self._server, self._loop, notices)
            if self._case is not None:
                add_case_button(self._server, self._loop, notices, self._case)
            self.main_panel = TuningPanel(self._server, self.tuning, notices, MAIN)
            self.sweep_panel = SweepPanel(
                self._server, self._loop, self.tuning, notices, robot, sweeps
            )
        with tabs.add_tab("Border & force"):
            add_border_choice(self._server, self.view, self.tuning, notices, mobile)
            self.border_panel = TuningPanel(self._server, self.tuning, notices, BORDER_AND_FORCE)
        with tabs.add_tab("Gains"):
            self.gains_panel = TuningPanel(self._server, self.tuning, notices, GAINS)
        with tabs.add_tab("View"):
            view_panel = ViewPanel(self._server, self.view, notices)
        view_panel.reset_camera.on_click(notices.guard(self._reset_camera))  # type: ignore[arg-type]
        live = gui.add_panel()
        with live.add_tab("Live", viser.Icon.CHART_LINE):
            self._legend = gui.add_html(legend_html(None))
            self._plots = Plots(self._server, names)
        live.dock_left()
        live.set_width(PANEL_WIDTH)

    async def _welcome(self, client: viser.ClientHandle) -> None:
        """Show a new viewer the base where it is by now."""
        self._stage.reset_camera(client, self._loop.latest().base_pose[:2])

    def _reset_camera(self, event: viser.GuiEvent) -> None:
        if event.client is not None:
            self._stage.reset_camera(event.client, self._loop.latest().base_pose[:2])

    def _apply_view(self) -> None:
        wanted = (self.view.meshes, self.view.bodies, self.view.dark)
        if wanted == self._shown:
            return
        if self._shown and self._shown[2] != self.view.dark:
            self._stage.theme(dark=self.view.dark)
        self._robot.show(meshes=self.view.meshes, bodies=self.view.bodies)
        self._shown = wanted


class _Borders:
    """Borders of all pairs of L_m, and the values that they are coloured by."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud]) -> None:
        self._clouds = clouds
        # A pair of L_m is named `lm-<body of the arm>`.
        self._fields = {pair: ScoreField.of(model, pair.partition("-")[2]) for pair in clouds}

    def points(self, pair: str, border: BorderConfig) -> Array:
        return construct_dbb(self._clouds[pair], border.d_b, border.eps).points

    def values(self, quantity: str, pair: str, points: Array) -> Array:
        field = self._fields[pair]
        if quantity == "determinant":
            return field.singularity(points)
        return field.reachability(points) if quantity == "reachability" else field.score(points)


def _escape(error: BaseException) -> str:
    text = f"{type(error).__name__}: {error}"
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
