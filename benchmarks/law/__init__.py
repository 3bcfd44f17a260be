"""Measurements of the control law: continuity, tracking, and pulls and releases by people."""
