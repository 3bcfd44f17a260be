"""Other libraries on the same robot and the same hand paths: `python -m benchmarks.peers`."""
