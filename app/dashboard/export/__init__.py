"""Pictures and replays, drawn without a display."""
