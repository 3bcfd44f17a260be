"""The distance buffer border: points around the mobile base, their score, and stored files."""
