"""Command line: options to settings and values, one call of a workflow or study, an exit code."""

from replay_kit.cli.app import main

__all__ = ["main"]
