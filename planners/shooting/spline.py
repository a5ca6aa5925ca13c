"""A B-spline of a flow's stream function for the optimiser: its cost grows with neither the nodes nor the lattice; its error is measured.

The spline is of degree five in the plane, so that velocities have continuous second derivatives and no divergence. It covers the
surroundings of a mission; beyond them its current fades to none. Levels and times stay those of the flow. Its coefficients are those of the
factors along each axis (``stream.py``): two banded solutions and a product for each column.
"""

from dataclasses import dataclass, replace
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from planners.flow import graph_key
from planners.shooting.stream import ORDERS, Stream, stream_of
from planners.solver import Recent
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.functions import depth_weights

_DEGREE = 5
_WINDOW = _DEGREE + 1
# Cells beyond those over which the spline fades: its ends are felt there, and less than 1e-8 of that within.
_BEYOND = 24
# Random places at which the error is measured.
_PLACES = 300


@dataclass(frozen=True, slots=True, eq=False)
class FlowSpline:
    """The stream function of a flow as a B-spline.

    Attributes:
        origin: shape (2,) [m], where the cell of the first window begins.
        spacing: shape (2,) [m].
        windows: shape (C, n_east, n_north, 6, 6), the coefficients that count in each cell [m^2/s].
        low: shape (2,) [m], least east and north of what it covers.
        high: shape (2,) [m], largest.
        largest_error: Of its velocity at random places of its surroundings, each at a random depth and time [m/s].
        rms_error: Root mean square of that.
    """

    origin: Array
    spacing: Array
    windows: Array
    low: Array
    high: Array
    largest_error: float = 0.0
    rms_error: float = 0.0

    def covers(self, places: Array) -> bool:
        """Return whether all of some places, shape (n, 2) [m], are within what the spline covers."""
        return bool(np.all((places >= self.low) & (places <= self.high)))

    def derivatives(
        self, place: Array, columns: NDArray[np.intp], weights: Array, orders: int = ORDERS
    ) -> Array:
        """Return the derivatives as ``Stream`` says."""
        at = (place - self.origin) / self.spacing
        cell = np.minimum(np.maximum(np.floor(at), 0.0), np.array(self.windows.shape[1:3]) - 1.0)
        share, first = at - cell, cell.astype(np.intp)
        powers = share[..., None] ** np.arange(_WINDOW)
        factors = (powers @ _BASIS[:, : orders * _WINDOW]).reshape(len(place), 2, orders, _WINDOW)
        factors /= self.spacing[:, None, None] ** np.arange(orders)[:, None]
        near = self.windows[columns, first[:, :1], first[:, 1:]]
        summed = np.matmul(weights, near.reshape(*columns.shape, -1)).reshape(
            *weights.shape[:2], _WINDOW, _WINDOW
        )
        return np.asarray(factors[:, None, 0] @ summed @ factors[:, 1].transpose(0, 2, 1)[:, None])


def _basis() -> Array:
    """Return the B-splines of a cell as polynomials of the share of it, with their derivatives: shape (6, 4 * 6), powers first."""
    # of those that count in a cell, the one that begins first is in its last piece; Cox and de Boor's recurrence, a degree at a time
    basis = np.ones((1, 1))
    for degree in range(1, _WINDOW):
        begun, share = np.arange(degree, -1.0, -1.0), np.zeros((2, degree + 1, degree + 1))
        share[0, :-1, 1:], share[1, :-1, :-1] = basis, basis
        basis = (begun * share[0] + (degree + 1.0 - begun) * share[1]) / degree
        basis[1:] += (share[0] - share[1])[:-1] / degree
    out = np.zeros((_WINDOW, ORDERS, _WINDOW))
    for order in range(ORDERS):
        out[: len(basis), order] = basis
        basis = np.arange(1, len(basis))[:, None] * basis[1:]
    return out.reshape(_WINDOW, -1)


_BASIS = _basis()
# in memory: several attempts at one mission share them
_splines = Recent[FlowSpline](4)


def spline_of(
    flow: FlowEstimate, latent: Array, points: int, low: Array, high: Array
) -> FlowSpline:
    """Return the B-spline of a flow's stream function over a box, with its error relative to the flow.

    Args:
        flow: Its functions.
        latent: shape (M, C), latent values of its levels, or of all levels of each time one after the other.
        points: Coefficients per kernel length; the error of the velocity falls with their fifth power.
        low: shape (2,) [m], the box's least east and north.
        high: shape (2,) [m], its largest.
    """
    key = (
        *graph_key(flow),
        blake2b(latent.tobytes()).digest(),
        latent.shape,
        points,
        low.tobytes(),
        high.tobytes(),
    )
    return _splines.get(key, lambda: _spline(flow, latent, points, low, high))


def _spline(flow: FlowEstimate, latent: Array, points: int, low: Array, high: Array) -> FlowSpline:
    lengths = np.array([flow.horizontal.kernel.length_east, flow.horizontal.kernel.length_north])
    spacing = lengths / points
    size, beyond = np.ceil((high - low) / spacing).astype(int) + 1, points + _WINDOW + _BEYOND
    sites = [low[i] + spacing[i] * np.arange(-beyond, size[i] + beyond) for i in (0, 1)]
    fading = [
        _fading(
            sites[i], low[i] - _WINDOW * spacing[i], high[i] + _WINDOW * spacing[i], lengths[i]
        )[:, None]
        for i in (0, 1)
    ]
    stream = stream_of(flow, latent)
    coefficients = stream.products(
        *(fading[i] * _coefficients(stream.factors(i, sites[i])) for i in (0, 1))
    )
    windows = np.lib.stride_tricks.sliding_window_view(
        coefficients, (_WINDOW, _WINDOW), axis=(1, 2)
    )
    spline = FlowSpline(
        np.array([axis[_DEGREE // 2] for axis in sites]), spacing, windows, low, high
    )
    largest, rms = _errors(flow, spline, stream)
    return replace(spline, largest_error=largest, rms_error=rms)


def _coefficients(samples: Array) -> Array:
    """Return the coefficients, shape (n, ...), of splines that have given values, shape (n, ...), at equally spaced places."""
    # at the beginning of a cell the last of its six is none
    at_sites = _BASIS[0, :_DEGREE]
    bands = np.tile(at_sites[:, None], (1, len(samples)))
    each_side = len(at_sites) // 2
    return np.asarray(
        solve_banded((each_side, each_side), bands, samples.reshape(len(samples), -1)).reshape(
            samples.shape
        )
    )


def _fading(sites: Array, low: float, high: float, length: float) -> Array:
    """Return 1 from low to high, falling to 0 over a length beyond them."""
    beyond = np.maximum(np.maximum(low - sites, sites - high), 0.0) / length
    return np.where(beyond < 1.0, np.cos(0.5 * np.pi * beyond) ** 2, 0.0)


def _errors(flow: FlowEstimate, spline: FlowSpline, stream: Stream) -> tuple[float, float]:
    """Return the largest and the root mean square error of the velocity [m/s] at random places, each at a random depth and time."""
    rng, n_levels = np.random.default_rng(0), flow.levels.size
    at = rng.uniform(spline.low, spline.high, (_PLACES, 2))
    depths = rng.uniform(flow.levels[0], flow.levels[-1], _PLACES)
    times = rng.integers(0, len(spline.windows) // n_levels, (_PLACES, 1))
    where = (
        at,
        times * n_levels + np.arange(n_levels),
        depth_weights(flow.depth_functions, depths, flow.levels)[:, None],
    )
    off = spline.derivatives(*where, 2) - stream.derivatives(*where, 2)
    error = np.hypot(off[:, 0, 0, 1], off[:, 0, 1, 0])
    return float(error.max()), float(np.sqrt(np.mean(error**2)))
