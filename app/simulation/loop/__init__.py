"""The live loop executes commands and publishes snapshots, at real time or a multiple of it."""
