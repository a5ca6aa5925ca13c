"""Truths that the twin's tests share."""

from collections.abc import Callable

import numpy as np

from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Ensemble, Grid, Projection

CENTRE = Projection(152.5, -40.0)
LEVELS = np.array([5.0, 50.0, 150.0, 300.0, 500.0, 750.0])

Flow = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def eddy(east, north, depth):
    """Return a smooth eddy that weakens with depth."""
    strength = 0.4 * np.exp(-((east / 40e3) ** 2) - (north / 40e3) ** 2 - depth / 600.0)
    return -strength * north / 30e3, strength * east / 30e3 + 0.05


def make_truth(
    flow: Flow = eddy,
    rows: int = 13,
    columns: int = 21,
    cell: float = 9000.0,
    bend: float = 0.08,
    levels: np.ndarray = LEVELS,
) -> Ensemble:
    """Return a truth on a curvilinear grid: turned by 20 degrees and bent."""
    x, y = np.meshgrid(
        (np.arange(columns) - (columns - 1) / 2) * cell, (np.arange(rows) - (rows - 1) / 2) * cell
    )
    x, y = x + bend * 30e3 * np.sin(y / 40e3), y + bend * 30e3 * np.cos(x / 50e3)
    cos, sin = np.cos(np.deg2rad(20.0)), np.sin(np.deg2rad(20.0))
    east, north = cos * x - sin * y, sin * x + cos * y
    longitude, latitude = to_geographic(CENTRE, east, north)
    velocity = np.array(flow(east, north, levels[:, None, None]))
    wet = np.ones(velocity.shape[1:], dtype=np.bool_)
    return Ensemble(
        Grid(CENTRE, longitude, latitude, east, north, levels, wet),
        velocity[None],
        None,
        "made here",
    )
