"""Studies of many runs: maps over directions, and random pulls by the thousand."""
