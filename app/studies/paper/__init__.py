"""The paper's experiments and figures (`dbb reproduce`)."""
