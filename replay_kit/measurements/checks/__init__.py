"""Consistency checks of the measurements of a log."""
