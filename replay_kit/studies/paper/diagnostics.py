"""Figures that explain the tables: the conditioning of the Gaussians in depth, and the coherence in depth of the truth."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import DepthFunctions, depth_weights
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.grid import Ensemble
from replay_kit.estimator.baselines import average_over_depth
from replay_kit.estimator.basis.slices import ensemble_slices


@dataclass(frozen=True, slots=True)
class DepthKernel:
    """The Gaussians in depth of the paper, on the levels of an ensemble.

    Attributes:
        length: l_z [m].
        condition: Of the matrix of the Gaussians at the levels.
        least_share: Least share of a current that is the same at all depths after its fit by the Gaussians.
        least_depth: Where [m].
        largest_share: Largest share.
        largest_depth: Where [m].
    """

    length: float
    condition: float
    least_share: float
    least_depth: float
    largest_share: float
    largest_depth: float


def depth_kernel(levels: Array, length: float) -> DepthKernel:
    """Return how the paper's Gaussians behave on levels.

    Args:
        levels: shape (Z,) [m].
        length: l_z [m].
    """
    functions = DepthFunctions("gaussian", length)
    matrix = depth_weights(functions, levels, levels)
    depths = np.linspace(levels[0], levels[-1], 1001)
    # least squares, because the matrix may be singular to machine precision
    share = (
        depth_weights(functions, depths, levels) @ np.linalg.lstsq(matrix, np.ones(levels.size))[0]
    )
    least, largest = int(np.argmin(share)), int(np.argmax(share))
    figures = (
        float(share[least]),
        float(depths[least]),
        float(share[largest]),
        float(depths[largest]),
    )
    return DepthKernel(length, float(np.linalg.cond(matrix)), *figures)


def coherence(flow: FlowEstimate, depth: float, steps: int = 50) -> float:
    """Return which share of a flow's mean squared speed from the surface to a depth its depth average carries.

    Args:
        flow: The flow, at its nodes.
        depth: [m].
        steps: Depths taken, in the middle of equal layers.
    """
    east, north = flow.nodes.T
    layers = depth * (np.arange(steps) + 0.5) / steps
    whole = np.mean(np.sum(flow.velocity(east[:, None], north[:, None], layers) ** 2, axis=-1))
    average = np.mean(
        np.sum(average_over_depth(flow, depth).velocity(east, north, 0.0) ** 2, axis=-1)
    )
    return float(average / whole)


def level_correlation(ensemble: Ensemble) -> tuple[float, float]:
    """Return the least and the largest correlation between neighbouring levels of the members' anomalies about their mean.

    Args:
        ensemble: The members; a level's anomalies are pooled over places, components and members.
    """
    slices = ensemble_slices(ensemble)
    anomalies = slices - slices.mean(axis=0)
    pairs = zip(np.moveaxis(anomalies, 1, 0)[:-1], np.moveaxis(anomalies, 1, 0)[1:], strict=True)
    of_pairs = [
        float(np.sum(upper * lower) / np.sqrt(np.sum(upper**2) * np.sum(lower**2)))
        for upper, lower in pairs
    ]
    return min(of_pairs, default=1.0), max(of_pairs, default=1.0)
