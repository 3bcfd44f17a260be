"""Many runs: the figures of the paper, sweeps, random pulls, and their reports."""
