"""The page in the browser: scene, panels, plots. Only this package of `app` imports viser."""
