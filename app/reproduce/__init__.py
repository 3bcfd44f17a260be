"""The paper's experiments and figures: what was measured here beside what the paper says."""
