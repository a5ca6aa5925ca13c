"""The version of replay-kit, which files record; here, because the top of the package imports everything else."""

__version__ = "0.3.0"
