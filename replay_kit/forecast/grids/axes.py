"""Physical test of the axes of velocities, which files often label wrongly.

Both readings (along the grid, or along true east and north) are tested by the fraction of the variance that no divergence-free flow
explains. If the file has the sea surface height, the angle between the current and the geostrophic one is tested too.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array, Values
from replay_kit.core.geodesy import to_local, unwrap_longitude
from replay_kit.core.grid import Projection
from replay_kit.forecast.grids.horizontal import turn_to_local
from replay_kit.forecast.grids.layout import Layout
from replay_kit.forecast.names import Axes
from replay_kit.forecast.window import Window

_Complex = NDArray[np.complex128]
_GRAVITY = 9.81
_ROTATION = 7.2921e-5
# Below this angle between grid and true axes nothing depends on the reading [degrees].
_LEAST_ANGLE = 1.0
_MOST_NODES = 60
_MOST_MEMBERS = 4
_LEAST_CORRELATION = 0.5
_LEAST_WET = 100
# On NEMO at 0.25 degree, 0.002 to 0.004 read rightly, 0.02 to 0.09 with a grid at up to 20 to 40 degrees read wrongly.
_LEAST_SHARE = 0.01


@dataclass(frozen=True, slots=True)
class AxesCheck:
    """Test of the velocity axes.

    Attributes:
        axes: Axes as read.
        why: Reason for this reading.
        angle: Largest angle between the grid and true axes [degrees].
        residual: Fraction of the variance that no divergence-free flow explains, as read and turned; None if not tested.
        phase: Angle from the geostrophic current to the current [degrees], as read and turned; None if not tested.
        contradicted: Whether the other reading fits better.
        residual_std: RMS component that no divergence-free flow explains, as read [m/s]; 0 if not tested.
    """

    axes: Axes
    why: str
    angle: float
    residual: tuple[float, float] | None = None
    phase: tuple[float, float] | None = None
    contradicted: bool = False
    residual_std: float = 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """Warning of a wrong reading, with the option that corrects it; empty if none was found."""
        if not self.contradicted:
            return ()
        other: Literal["grid", "true"] = "true" if self.axes == "grid" else "grid"
        return (
            f"WARNING: the velocities are used as read, along {_NAMES[self.axes]} ({self.why}), but fit {_NAMES[other]} better: "
            f"{self.figures}; --axes {other} turns them, --axes {self.axes} keeps this reading; until then the "
            f"{100 * self.residual_std:.1f} cm/s count as representation error",
        )

    @property
    def figures(self) -> str:
        """Results of the test as text."""
        found = []
        if self.residual is not None:
            found.append(
                f"RMS divergent part {100 * self.residual_std:.1f} cm/s as read ({100 * self.residual[0]:.0f} % of the variance), "
                f"{100 * self.residual[1]:.0f} % turned"
            )
        if self.phase is not None:
            found.append(
                f"angle to the geostrophic current {self.phase[0]:.0f} degrees as read, {self.phase[1]:.0f} turned"
            )
        return "; ".join(found) or "not tested"


_NAMES = {"grid": "the grid's axes", "true": "true east and north"}


def check_axes(
    window: Window, layout: Layout, velocity: Values, wet: NDArray[np.bool_], projection: Projection
) -> AxesCheck:
    """Return the test of the axes along which velocities were read.

    Args:
        window: Window of the first file.
        layout: Layout of the first file.
        velocity: Members as read, in the local frame, shape (E, 2, Z, J, I) [m/s].
        wet: Water points, shape (Z, J, I).
        projection: Local frame.
    """
    true, grid = (
        turn_to_local(projection, window.longitude, window.latitude, axes)
        for axes in ("true", "grid")
    )
    turn = grid * true.conj()
    angle = float(np.degrees(np.abs(np.angle(turn))).max())
    found = AxesCheck(layout.axes, layout.why, angle)
    if angle < _LEAST_ANGLE:
        return found
    # from the reading made to the other one
    other = np.conj(turn) if layout.axes == "grid" else turn
    longitude = unwrap_longitude(window.longitude, projection.longitude)
    east, north = to_local(projection, longitude, window.latitude)
    level = _level(window.levels, wet)
    cut = tuple(
        slice((n - min(n, _MOST_NODES)) // 2, (n + min(n, _MOST_NODES)) // 2) for n in east.shape
    )
    water = wet[level][cut]
    if water.sum() < _LEAST_WET:
        return found
    members = np.unique(np.linspace(0, len(velocity) - 1, _MOST_MEMBERS).astype(int))
    flow = (velocity[members, 0, level] + 1j * velocity[members, 1, level])[:, *cut]
    place = east[cut], north[cut]
    read, turned = (divergent_share(*place, field, water) for field in (flow, flow * other[cut]))
    phase = None
    if window.sea_level is not None:
        phase = _phases(
            window.sea_level[cut], place, window.latitude[cut], flow[0], other[cut], water
        )
    by_phase = phase is not None and abs(phase[0]) > 15.0 and abs(phase[1]) < abs(phase[0]) - 10.0
    agrees = phase is not None and abs(phase[0]) < abs(phase[1])
    by_share = read > _LEAST_SHARE and read > 3.0 * turned and not agrees
    std = float(np.sqrt(read * np.mean(np.abs(flow[:, water]) ** 2) / 2.0))
    return AxesCheck(
        layout.axes, layout.why, angle, (read, turned), phase, bool(by_phase or by_share), std
    )


def _level(levels: Array, wet: NDArray[np.bool_]) -> int:
    """Return the position of the level with water nearest to 50 m, below the wind drift."""
    nearest = np.argsort(np.abs(levels - 50.0))
    return int(next((k for k in nearest if wet[k].sum() >= 0.5 * wet[0].sum()), 0))


def divergent_share(east: Array, north: Array, flow: _Complex, wet: NDArray[np.bool_]) -> float:
    """Return the fraction of the variance of fields that no stream function explains.

    A stream function at the cells' corners is fitted to the current at the nodes by least squares. A slight penalty on its roughness
    avoids a fit of noise.

    Args:
        east: East of the nodes [m], shape (J, I).
        north: North of the nodes [m], shape (J, I).
        flow: East and north component as one complex number [m/s], shape (E, J, I).
        wet: Water points, shape (J, I).
    """
    # loads slowly, and most grids lie along true axes
    from scipy.sparse import diags_array, eye_array, kron, vstack
    from scipy.sparse.linalg import spsolve

    def bands(n: int, *values: float) -> Any:
        shape = (n, n + len(values) - 1)
        return diags_array(values, offsets=range(len(values)), shape=shape, format="csr")

    ny, nx = east.shape
    d_j = kron(bands(ny, -1.0, 1.0), bands(nx, 0.5, 0.5))
    d_i = kron(bands(ny, 0.5, 0.5), bands(nx, -1.0, 1.0))
    (e_j, e_i), (n_j, n_i) = np.gradient(east), np.gradient(north)
    determinant = e_i * n_j - e_j * n_i
    # derivatives along east and north from those along i and j
    d_e, d_n = (
        diags_array((of_i / determinant).ravel()) @ d_i
        - diags_array((of_j / determinant).ravel()) @ d_j
        for of_i, of_j in ((n_j, n_i), (-e_j, -e_i))
    )
    used = wet.ravel()
    operator = vstack([-d_n.tocsr()[used], d_e.tocsr()[used]]).tocsc()
    operator = operator / abs(operator).max()
    curved = (1.0, -2.0, 1.0)
    rough = vstack(
        [
            kron(bands(ny - 1, *curved), eye_array(nx + 1)),
            kron(eye_array(ny + 1), bands(nx - 1, *curved)),
        ]
    )
    normal = operator.T @ operator + 1e-3 * rough.T @ rough + 1e-9 * eye_array(operator.shape[1])
    data = np.concatenate([flow.real[:, wet], flow.imag[:, wet]], axis=1).T
    fitted = operator @ spsolve(normal.tocsc(), operator.T @ data).reshape(operator.shape[1], -1)
    return float(np.sum((data - fitted) ** 2) / max(np.sum(data**2), np.finfo(float).tiny))


def _phases(
    height: Array,
    place: tuple[Array, Array],
    latitude: Array,
    flow: _Complex,
    other: _Complex,
    wet: NDArray[np.bool_],
) -> tuple[float, float] | None:
    """Return the angles from the geostrophic current to the current, as read and turned [degrees]; None if uncorrelated."""
    geostrophic = geostrophic_flow(height, place, latitude)
    used = wet & np.isfinite(geostrophic) & (np.abs(latitude) > 8.0)
    if used.sum() < _LEAST_WET:
        return None
    found = []
    for field in (flow[used], flow[used] * other[used]):
        a, b = field - field.mean(), geostrophic[used] - geostrophic[used].mean()
        found.append(
            np.mean(a * np.conj(b))
            / max(np.sqrt(np.mean(np.abs(a) ** 2) * np.mean(np.abs(b) ** 2)), np.finfo(float).tiny)
        )
    if max(abs(value) for value in found) < _LEAST_CORRELATION:
        return None
    return float(np.degrees(np.angle(found[0]))), float(np.degrees(np.angle(found[1])))


def geostrophic_flow(height: Array, place: tuple[Array, Array], latitude: Array) -> _Complex:
    """Return the geostrophic current of a sea surface height [m/s], east and north component as one complex number, shape (J, I).

    Args:
        height: Sea surface height [m], shape (J, I).
        place: East and north of the nodes [m], each of shape (J, I).
        latitude: Latitude [degrees north], shape (J, I).
    """
    (h_j, h_i), (e_j, e_i), (n_j, n_i) = (np.gradient(part) for part in (height, *place))
    determinant = e_i * n_j - e_j * n_i
    slope_e, slope_n = (h_i * n_j - h_j * n_i) / determinant, (h_j * e_i - h_i * e_j) / determinant
    factor = _GRAVITY / (2.0 * _ROTATION * np.sin(np.deg2rad(latitude)))
    return np.asarray(factor * (-slope_n + 1j * slope_e))
