"""Work in other processes: pools, and background jobs that report progress and can be stopped."""
