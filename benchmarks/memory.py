"""The memory of a benchmark's process."""

import resource
import sys


def peak_memory() -> float:
    """[MB] peak memory of this process."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / 1e6 if sys.platform == "darwin" else peak * 1024 / 1e6  # Linux: in KiB
