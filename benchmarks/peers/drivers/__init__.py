"""A program for each library, which runs with its own interpreter and imports only this library and
numpy.
"""
