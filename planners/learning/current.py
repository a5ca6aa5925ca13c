"""Many currents at once, as cubic B-splines of place, linear in time, with exact derivatives. Vectors are complex, east + i north."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import spline_filter1d

from planners.front.current import Complex
from replay_kit.core.arrays import Array
from replay_kit.core.flow.estimate import FlowEstimate

# Coefficients a kernel length: at four the error of a Gaussian's flow is some 1e-3 of it.
_PER_LENGTH = 4.0
# Cells around the region that the spline covers too.
_AROUND = 2


@dataclass(frozen=True, slots=True, eq=False)
class Currents:
    """S currents, of which each point asks its own.

    Attributes:
        origin: East and north of the first coefficient [m].
        spacing: Along both [m].
        times: shape (T,), increasing [s].
        coefficients: shape (S, T, n_north, n_east) [m/s]; constant beyond places and times.
    """

    origin: complex
    spacing: complex
    times: Array
    coefficients: Complex

    def at(self, places: Complex, time: Array | float) -> Complex:
        """Return the current [m/s] at places, shape (S, ...) [m], and times that broadcast with them [s]."""
        return self._summed(places, time, False)[0]

    def with_gradient(
        self, places: Complex, time: Array | float
    ) -> tuple[Complex, Complex, Complex]:
        """Return the current [m/s] and its derivatives along east and north [1/s], as ``at``."""
        return self._summed(places, time, True)

    def _summed(
        self, places: Complex, time: Array | float, derivatives: bool
    ) -> tuple[Complex, Complex, Complex]:
        count, _, rows, columns = self.coefficients.shape
        x = (places.real - self.origin.real) / self.spacing.real
        y = (places.imag - self.origin.imag) / self.spacing.imag
        x, y = np.clip(x, 1.0, columns - 2.001), np.clip(y, 1.0, rows - 2.001)
        column, row = x.astype(np.intp), y.astype(np.intp)
        across, along = _hats(x - column, derivatives), _hats(y - row, derivatives)
        number = np.interp(time, self.times, np.arange(self.times.size, dtype=np.float64))
        slot = np.minimum(number.astype(np.intp), max(self.times.size - 2, 0))
        share = np.broadcast_to(number - slot, places.shape)
        which = np.arange(count).reshape(-1, *(1,) * (places.ndim - 1))
        corner = ((which * self.times.size + slot) * rows + row - 1) * columns + column - 1
        around = self._around(corner, share)
        value = _weighed(around, across[0], along[0])
        if not derivatives:
            return value, value, value
        by_east = _weighed(around, across[1], along[0]) / self.spacing.real
        return value, by_east, _weighed(around, across[0], along[1]) / self.spacing.imag

    def _around(self, corner: NDArray[np.intp], share: Array) -> Complex:
        """Return the coefficients around points, shape (..., 4, 4), along north first, between two times."""
        _, n_times, rows, columns = self.coefficients.shape
        flat, at = (
            self.coefficients.reshape(-1),
            corner[..., None, None] + columns * np.arange(4)[:, None] + np.arange(4),
        )
        before = flat.take(at)
        if n_times == 1:
            return np.asarray(before)
        return np.asarray(
            before + share[..., None, None] * (flat.take(at + rows * columns) - before)
        )


def _weighed(around: Complex, across: Array, along: Array) -> Complex:
    return np.asarray((around * (along[..., :, None] * across[..., None, :])).sum(axis=(-2, -1)))


def _hats(share: Array, derivatives: bool) -> tuple[Array, Array]:
    """Return the four cubic B-splines that reach a place between two coefficients, shape (..., 4), and their derivatives if wanted."""
    rest = 1.0 - share
    value = [
        rest**3,
        3.0 * share**3 - 6.0 * share**2 + 4.0,
        3.0 * rest**3 - 6.0 * rest**2 + 4.0,
        share**3,
    ]
    hats = np.stack(value, axis=-1) / 6.0
    if not derivatives:
        return hats, hats
    slope = [-(rest**2), 3.0 * share**2 - 4.0 * share, -3.0 * rest**2 + 4.0 * rest, share**2]
    return hats, np.stack(slope, axis=-1) / 2.0


def currents_of(flow: FlowEstimate, latent: Sequence[Array], times: Array) -> Currents:
    """Return currents of latent values on a flow's functions.

    Args:
        flow: Its region and functions.
        latent: At each time, shape (S, M): latent values of each current's mean over depth.
        times: shape (T,), increasing [s].
    """
    grid, kernel = flow.grid, flow.horizontal.kernel
    low, high = (np.array([pick(grid.east), pick(grid.north)]) for pick in (np.min, np.max))
    cells = np.maximum(
        np.ceil((high - low) / [kernel.length_east, kernel.length_north] * _PER_LENGTH), 1.0
    )
    spacing = (high - low) / cells
    east, north = (
        low[axis]
        + spacing[axis] * np.arange(-_AROUND, int(cells[axis]) + _AROUND + 1, dtype=np.float64)
        for axis in (0, 1)
    )
    points = np.stack(np.meshgrid(east, north), axis=-1).reshape(-1, 2)
    values = np.stack(
        [flow.horizontal.velocity(points, one.T) for one in latent], axis=-1
    )  # (2, P, S, T)
    table = (
        (values[0] + 1j * values[1])
        .transpose(1, 2, 0)
        .reshape(len(latent[0]), len(latent), north.size, east.size)
    )
    for axis in (2, 3):
        table = _filtered(table.real, axis) + 1j * _filtered(table.imag, axis)
    return Currents(
        complex(east[0], north[0]), complex(*spacing), times, np.ascontiguousarray(table)
    )


def _filtered(values: Array, axis: int) -> Array:
    return np.asarray(spline_filter1d(values, 3, axis, mode="mirror"))
