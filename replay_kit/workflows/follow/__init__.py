"""Logs that grow: replayed as they come."""
