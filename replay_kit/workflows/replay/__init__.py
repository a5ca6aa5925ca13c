"""Replay of logs from end to end."""
