"""Shared data types, geometry and statistics; the version, as recorded in files."""

__version__ = "0.4.0"
