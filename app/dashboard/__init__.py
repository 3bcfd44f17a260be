"""The page in the browser: scene, panels, plots. The only room that imports viser."""
