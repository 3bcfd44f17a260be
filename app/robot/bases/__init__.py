"""Kinds of mobile base, one per file: their motions, and their measure in the border's score."""
