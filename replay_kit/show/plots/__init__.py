"""Figures of a result for a paper, drawn with matplotlib: ``Result.plot`` and ``replay-kit plot``."""

from replay_kit.show.plots.panel import ENDINGS, Chosen
from replay_kit.show.plots.plots import KINDS, Plots, drawn

__all__ = ["ENDINGS", "KINDS", "Chosen", "Plots", "drawn"]
