"""The command line: settings to one workflow to an exit code."""

from replay_kit.cli.app import main

__all__ = ["main"]
