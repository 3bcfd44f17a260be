"""Reports of runs, and studies of many runs: the paper's figures, sweeps and random pulls."""
