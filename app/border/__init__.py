"""The distance buffer border: points around the mobile base, their score, and stored files.

The force at a point of the border, (12) to (16), is in `app.avoidance.acting_point`.
"""
