"""Everything around the robot: floor, lights, theme and cameras."""

from __future__ import annotations

import numpy as np
import viser

Array = np.ndarray

CAMERA = np.array([1.85, 1.85, 1.40])  # [m] in the base's frame: from the front left, above
LOOK_AT = np.array([0.32, 0.0, 0.40])  # [m] between the base and the hand before it
FIELD_OF_VIEW = np.deg2rad(42.0)  # [rad] vertical; longer than viser's 75°, so less distortion
BRAND = (38, 132, 214)


class Stage:
    """Floor, lights and theme of the page, and the cameras of its viewers."""

    def __init__(self, server: viser.ViserServer, title: str, *, dark: bool) -> None:
        """Set the stage; the camera is where new viewers begin."""
        self._server = server
        server.gui.set_panel_label(title)
        server.scene.configure_default_lights(enabled=True, cast_shadow=True)
        server.scene.add_light_hemisphere(
            "/lights/sky", sky_color=(255, 255, 255), ground_color=(120, 125, 135), intensity=0.35
        )
        server.initial_camera.position = CAMERA
        server.initial_camera.look_at = LOOK_AT
        server.initial_camera.fov = FIELD_OF_VIEW
        self.theme(dark=dark)
        self._followed: Array | None = None

    def theme(self, *, dark: bool) -> None:
        """Dark or light page, with a floor that can be read on either."""
        self._server.gui.configure_theme(
            dark_mode=dark, show_logo=False, show_share_button=False, brand_color=BRAND
        )
        self._server.scene.add_grid(
            "/floor", width=8.0, height=8.0, cell_size=0.1, section_size=1.0,
            cell_color=(58, 62, 68) if dark else (222, 225, 230),
            section_color=(98, 104, 114) if dark else (176, 182, 192),
            cell_thickness=0.8, section_thickness=1.2,
            fade_distance=9.0, fade_strength=1.5, shadow_opacity=0.35 if dark else 0.22,
            infinite_grid=True,
        )  # fmt: skip

    def follow(self, base_position: Array, *, on: bool) -> None:
        """Carry all cameras along with the base by what it has moved since the last call.

        Args:
            base_position: (2,) [m] the base's centre in the world.
            on: Whether to do so; off forgets where the base was.
        """
        if not on:
            self._followed = None
            return
        if self._followed is None:
            self._followed = np.array(base_position)
        step = np.append(base_position - self._followed, 0.0)
        if np.linalg.norm(step) < 1e-3:  # [m] nobody sees less
            return
        self._followed = np.array(base_position)
        for client in self._server.get_clients().values():
            with client.atomic():
                # Setting the position carries the point that is looked at along, by the same step.
                client.camera.position = client.camera.position + step

    def reset_camera(self, client: viser.ClientHandle, base_position: Array) -> None:
        """Give one viewer the first view again, of the base where it now is."""
        offset = np.append(base_position, 0.0)
        with client.atomic():
            client.camera.position = CAMERA + offset
            client.camera.look_at = LOOK_AT + offset
            client.camera.up_direction = np.array([0.0, 0.0, 1.0])
