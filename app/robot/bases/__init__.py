"""Kinds of mobile base, one a file: what each can do, and what its border's score is made of."""
