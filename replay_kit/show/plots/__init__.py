"""Figures of a result for a paper, drawn with matplotlib: ``Result.plot`` and ``replay-kit plot``."""
