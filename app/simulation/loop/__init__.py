"""The live loop: it keeps real time, takes commands and publishes snapshots."""
