"""Workflows behind the commands, one module or package each."""
