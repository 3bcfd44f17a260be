"""Child processes: a pool of workers, and single jobs with progress and cancellation."""
