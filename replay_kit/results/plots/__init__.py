"""Figures of a result for a paper, drawn with matplotlib: ``Result.plot`` and ``replay-kit plot``."""

from replay_kit.results.plots.plots import KINDS, Plots, drawn
from replay_kit.results.plots.style import ENDINGS

__all__ = ["ENDINGS", "KINDS", "Plots", "drawn"]
