"""One program a library, run by its own interpreter; each imports that library and numpy alone."""
