"""Constraints on position: no-go areas, the bottom, the edge of the forecast."""
