"""The record of a run: snapshots, traces, log files and figures."""
