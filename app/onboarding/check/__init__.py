"""`dbb check-robot`, row by row."""
