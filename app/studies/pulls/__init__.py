"""Random pulls by the thousand (`dbb study`)."""
