"""Other libraries on the same robot and paths: `python -m benchmarks.peers`."""
