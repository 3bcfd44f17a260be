"""Changing and building robots from the page."""
