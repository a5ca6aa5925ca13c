"""Outcome of a run as one value, for its summary, JSON, status, report and fleet table."""
