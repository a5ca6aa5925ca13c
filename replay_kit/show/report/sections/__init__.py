"""Sections of a report, each a pure function of the opened result."""
