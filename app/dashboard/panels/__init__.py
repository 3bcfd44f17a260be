"""The control panel, one builder a tab."""
