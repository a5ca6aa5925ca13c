"""Version of replay-kit, as recorded in files."""

__version__ = "0.4.0"
