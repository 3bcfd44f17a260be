"""The report of one run (`dbb report`)."""
