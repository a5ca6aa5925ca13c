"""Shared data types, geometry and statistics."""
