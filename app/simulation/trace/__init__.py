"""The record of a run: snapshots, logs and figures."""
