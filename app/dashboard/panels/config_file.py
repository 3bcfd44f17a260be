"""The configuration as a file: saved to the viewer's computer, loaded from there."""

from __future__ import annotations

import re
from typing import Any

import viser

from app.config_file import decode_config, save_config
from app.dashboard.notifications import Notices
from app.dashboard.tuning import Tuning
from app.errors import ConfigError

FIRST_NAME = "tuning"


class ConfigFilePanel:
    """A name, a button that saves, and one that loads, in the GUI container that is open."""

    def __init__(self, gui: viser.GuiApi, tuning: Tuning, notices: Notices) -> None:
        """Add the widgets.

        Args:
            gui: Of the page or of one client.
            tuning: What is saved, and takes over what is loaded.
            notices: Tells what is wrong with a file.
        """
        self._tuning = tuning
        self._name = gui.add_text("Name", FIRST_NAME, hint="Of the file, without .toml")
        save = gui.add_button(
            "Save", icon=viser.Icon.DOWNLOAD, hint="For --config of dbb run, serve and sweep"
        )
        load = gui.add_upload_button(
            "Load",
            icon=viser.Icon.UPLOAD,
            color="gray",
            mime_type=".toml",
            hint="A TOML file; what is not in it goes to its default",
        )
        save.on_click(notices.guard(self._save))  # type: ignore[arg-type]
        load.on_upload(notices.guard(self._load))  # type: ignore[arg-type]

    def _save(self, event: Any) -> None:
        name = self._name.value.strip()
        text = save_config(self._tuning.config, name)
        event.client.send_file_download(
            file_name(name), text.encode("utf-8"), save_immediately=True
        )

    def _load(self, event: Any) -> None:
        file: viser.UploadedFile = event.target.value
        try:
            loaded = decode_config(file.content)
        except ConfigError as error:
            raise ConfigError(f"{file.name[:60]}: {error}") from None
        self._tuning.load(loaded.config)
        self._name.value = loaded.name or file.name.removesuffix(".toml")[:60]


def file_name(name: str) -> str:
    """A name for a file on any system, as in `stiff arm.toml`."""
    safe = re.sub(r"[^\w .+-]", "-", name).strip(" .")
    return f"{safe or FIRST_NAME}.toml"
