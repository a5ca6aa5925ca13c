"""MCAP logs, read and written."""
