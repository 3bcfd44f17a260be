"""Studies of many random pulls (`dbb study`)."""
