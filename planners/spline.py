"""A B-spline of a flow for the optimiser: its cost does not grow with the number of nodes; it is not exact, and its error is measured.

It is cubic in the plane. In depth it is linear between the levels where the flow is, and cubic otherwise. It represents one estimate only
and is not divergence-free; outside its box it has the value at the edge.

Over random eddies of 0.2 m/s and a kernel length of 12 km it is 0.2 mm/s off at most with three coefficients per kernel length (two: 1.3
mm/s, four: 0.07 mm/s), and a plan of 16 h made in it misses by 6 m when it is flown in the flow itself. One evaluation with first and
second derivatives takes 7 us or less, whatever the nodes; the flow's own takes 9, 26 and 44 us at 527 nodes. But the spline and the graph
that holds it are made for each estimate. Processor time for ten dives, in the flow and in the spline with two coefficients per length:

    nodes   first plan        again on the same estimate   on a new estimate
    80      0.19 s, 0.26 s    0.12 s, 0.11 s               0.10 s, 0.31 s
    527     0.74 s, 0.78 s    0.56 s, 0.24 s               0.66 s, 0.75 s
    2040    2.2 s, 4.2 s      1.8 s, 1.3 s                 1.5 s, 4.8 s

It is faster only where one estimate of some hundred nodes is used for several plans with the same number of legs.
"""

from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline

from planners.flow import graph_key
from planners.solver import Recent
from replay_kit.core.arrays import Array
from replay_kit.core.flow.depth import depth_weights
from replay_kit.core.flow.estimate import FlowEstimate

_CUBIC = 3
# Random places in the box at which the error is measured.
_PLACES = 2000
# Places at which the flow is evaluated at once.
_CHUNK = 1024


@dataclass(frozen=True, slots=True, eq=False)
class FlowSpline:
    """A flow as a B-spline.

    Attributes:
        function: (east, north, depth) in one vector [m] -> velocity [m/s], for CasADi.
        largest_error: Of its velocity at random places of the flow's grid, between its levels [m/s].
        rms_error: Root mean square of that.
    """

    function: ca.Function
    largest_error: float
    rms_error: float


@dataclass(frozen=True, slots=True, eq=False)
class _Axis:
    """Knots along one axis [m], the outermost repeated, and the degree between them."""

    knots: Array
    degree: int

    @property
    def sites(self) -> Array:
        """One place for each coefficient, the mean of its knots: there the spline equals the flow."""
        return np.array([self.knots[i + 1 : i + 1 + self.degree].mean() for i in range(self.knots.size - self.degree - 1)])

    def basis(self, at: Array) -> Array:
        """Return the weights of the coefficients, shape (n, n_coefficients), at places [m]."""
        return np.asarray(BSpline.design_matrix(np.clip(at, self.knots[0], self.knots[-1]), self.knots, self.degree).toarray())


# in memory, and with them the programs built from them
_splines = Recent[FlowSpline](4)


def spline_of(flow: FlowEstimate, points: int = 3) -> FlowSpline:
    """Return the B-spline of a flow over its grid, its levels and a kernel length around, with its error relative to the flow.

    Args:
        flow: The flow.
        points: Coefficients per kernel length; the error falls with their fourth power.
    """
    return _splines.get((*graph_key(flow), flow.latent.tobytes(), points), lambda: _spline(flow, points))


def _spline(flow: FlowEstimate, points: int) -> FlowSpline:
    axes = _axes(flow, points)
    coefficients = _values(flow, *(axis.sites for axis in axes))
    for i, axis in enumerate(axes):
        inverse = np.linalg.inv(axis.basis(axis.sites))
        coefficients = np.moveaxis(np.tensordot(inverse, coefficients, axes=(1, i)), 0, i)
    place = ca.MX.sym("place", 3)
    # CasADi counts the components first, then east, north, depth
    ordered = coefficients.transpose(2, 1, 0, 3).ravel()
    spline = ca.Function.bspline("spline", [axis.knots.tolist() for axis in axes], ordered.tolist(), [axis.degree for axis in axes], 2, {})
    low, high = (ca.DM([axis.knots[end] for axis in axes]) for end in (0, -1))
    function = ca.Function("flow_spline", [place], [spline(ca.fmin(ca.fmax(place, low), high))], {"never_inline": True})
    return FlowSpline(function, *_error(flow, axes, coefficients))


def _axes(flow: FlowEstimate, points: int) -> tuple[_Axis, _Axis, _Axis]:
    grid, kernel, levels = flow.grid, flow.horizontal.kernel, flow.levels
    east, north = (
        _cubic(float(values.min()) - length, float(values.max()) + length, length / points)
        for values, length in ((grid.east, kernel.length_east), (grid.north, kernel.length_north))
    )
    if levels.size == 1:
        # the same at all depths
        return east, north, _Axis(np.array([levels[0], levels[0], levels[0] + 1.0, levels[0] + 1.0]), 1)
    if flow.depth_functions.kind == "hat":
        return east, north, _Axis(np.concatenate([levels[:1], levels, levels[-1:]]), 1)
    return east, north, _cubic(float(levels[0]), float(levels[-1]), flow.depth_functions.length / points)


def _cubic(low: float, high: float, spacing: float) -> _Axis:
    inner = np.linspace(low, high, int(np.ceil((high - low) / spacing)) + 1)
    return _Axis(np.concatenate([[low] * _CUBIC, inner, [high] * _CUBIC]), _CUBIC)


def _values(flow: FlowEstimate, east: Array, north: Array, depth: Array) -> Array:
    """Return the velocity [m/s] on a grid, shape (n_east, n_north, n_depth, 2)."""
    at = np.column_stack([axis.ravel() for axis in np.meshgrid(east, north, indexing="ij")])
    layers = flow.latent @ depth_weights(flow.depth_functions, depth, flow.levels).T
    parts = [flow.horizontal.velocity(at[i : i + _CHUNK], layers).transpose(1, 2, 0) for i in range(0, len(at), _CHUNK)]
    return np.concatenate(parts).reshape(east.size, north.size, depth.size, 2)


def _error(flow: FlowEstimate, axes: tuple[_Axis, _Axis, _Axis], coefficients: Array) -> tuple[float, float]:
    """Return the largest and the root mean square error [m/s] at random places of the grid, each at a random depth between the levels."""
    grid, rng = flow.grid, np.random.default_rng(0)
    spans = (grid.east, grid.north, flow.levels)
    at = np.column_stack([rng.uniform(values.min(), values.max(), _PLACES) for values in spans])
    bases = [axis.basis(at[:, i]) for i, axis in enumerate(axes)]
    error = np.einsum("pi,pj,pk,ijkc->pc", *bases, coefficients, optimize=True) - flow.velocity(*at.T)
    size = np.linalg.norm(error, axis=1)
    return float(size.max()), float(np.sqrt(np.mean(size**2)))
