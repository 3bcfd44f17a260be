"""The distance buffer border, a surface or points around the base; its score and stored files."""
