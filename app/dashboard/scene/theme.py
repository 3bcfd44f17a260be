"""Theme: floor, lights, and a dark or light page."""

from __future__ import annotations

import viser

BRAND = (38, 132, 214)
BACKGROUND = {True: (20, 20, 20), False: (255, 255, 255)}
"""Of a dark and of a light page, behind the scene."""


def set_lights(scene: viser.SceneApi) -> None:
    """Lights that leave no side of the robot black."""
    scene.configure_default_lights(enabled=True, cast_shadow=True)
    scene.add_light_hemisphere(
        "/lights/sky", sky_color=(255, 255, 255), ground_color=(120, 125, 135), intensity=0.35
    )


def set_floor(scene: viser.SceneApi, *, dark: bool) -> None:
    """A grid of 0.1 m with lines of 1 m, that can be read on a dark or a light page."""
    scene.add_grid(
        "/floor",
        width=8.0,
        height=8.0,
        cell_size=0.1,
        section_size=1.0,
        cell_color=(58, 62, 68) if dark else (222, 225, 230),
        section_color=(98, 104, 114) if dark else (176, 182, 192),
        cell_thickness=0.8,
        section_thickness=1.2,
        fade_distance=9.0,
        fade_strength=1.5,
        shadow_opacity=0.35 if dark else 0.22,
        infinite_grid=True,
    )


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    """Dark or light page."""
    gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, brand_color=BRAND)
