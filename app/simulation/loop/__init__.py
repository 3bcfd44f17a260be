"""The live loop, which runs in real time, executes commands and publishes snapshots."""
