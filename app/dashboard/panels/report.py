"""The report of a robot that was made here, in the page."""

from __future__ import annotations

import re

import viser

from app.dashboard.notifications import Notices
from app.errors import AssetError
from app.robot.assets import robot_folder

_STYLE = (
    "<style>.dbb-report table{border-collapse:collapse;width:100%;font-size:.82em}"
    ".dbb-report th,.dbb-report td{text-align:left;vertical-align:top;padding:.2em .7em .2em 0;"
    "border-bottom:1px solid rgba(128,138,150,.3)}"
    ".dbb-report img{width:100%;height:auto;background:#fff;border-radius:4px}"
    ".mantine-Modal-content:has(.dbb-report){flex:0 0 min(62rem,92vw)!important}"
    ".dbb-report h2{font-size:1.05em;margin:1.2em 0 .3em}.dbb-report .scroll{overflow-x:auto}"
    ".dbb-report ul{padding-left:1.2em}</style>"
)


def show_report(client: viser.ClientHandle, name: str, notices: Notices) -> None:
    """Open it over the page, with a button to keep it as a file.

    Args:
        client: The viewer.
        name: Of the robot.
        notices: For what goes wrong.

    Raises:
        AssetError: The robot has none.
    """
    path = robot_folder(name) / "report.html"
    if not path.is_file():
        raise AssetError(f"{name}: there is no report {path}")
    page = path.read_text(encoding="utf-8")
    modal = client.gui.add_modal(f"How {name} was made")
    with modal:
        keep = client.gui.add_button("Keep as a file", icon=viser.Icon.DOWNLOAD, color="gray")
        client.gui.add_html(report_html(page))
        shut = client.gui.add_button("Close")

    def send(_: viser.GuiEvent) -> None:
        client.send_file_download(f"{name}-report.html", page.encode(), save_immediately=True)

    keep.on_click(notices.guard(send))  # type: ignore[arg-type]
    shut.on_click(notices.guard(lambda _: modal.close()))  # type: ignore[arg-type]


def report_html(page: str) -> str:
    """The report's content, without what belongs to a page of its own."""
    body = re.search(r"<body[^>]*>(.*)</body>", page, re.DOTALL)
    return f'{_STYLE}<div class="dbb-report">{body[1] if body else ""}</div>'
