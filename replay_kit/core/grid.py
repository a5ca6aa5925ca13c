"""Local frame, forecast grid, ensemble members on it, and seabed."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array, Mask, Values, one_by_one, release
from replay_kit.core.words.text import span_text, time_text


@dataclass(frozen=True, slots=True)
class Projection:
    """Centre of the azimuthal equidistant projection (WGS84) that defines a local east-north frame.

    Attributes:
        longitude: Centre [degrees east].
        latitude: Centre [degrees north].
    """

    longitude: float
    latitude: float


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Grid:
    """A forecast's grid in its local frame: a product in depth, curvilinear in the horizontal.

    Attributes:
        projection: The local frame.
        longitude: shape (J, I) [degrees east], continuous across the antimeridian.
        latitude: shape (J, I) [degrees north].
        east: shape (J, I) [m], local frame.
        north: shape (J, I) [m], local frame.
        levels: shape (Z,) [m], positive down, increasing.
        wet: shape (Z, J, I), True where the forecast has a velocity.
    """

    projection: Projection
    longitude: Array
    latitude: Array
    east: Array
    north: Array
    levels: Array
    wet: Mask

    def __repr__(self) -> str:
        """Return shape and extent as text."""
        z, j, i = self.wet.shape
        region = f"longitude {span_text(self.longitude)}, latitude {span_text(self.latitude)} degrees, depth {span_text(self.levels)} m"
        return (
            f"Grid of {z} levels x {j} x {i} points ({100.0 * self.wet.mean():.0f} % wet): {region}"
        )

    @property
    def nodes(self) -> Array:
        """Points that are wet at the first level, shape (N, 2) [m], local east and north."""
        top = self.wet[0]
        return np.column_stack([self.east[top], self.north[top]])

    @property
    def ends(self) -> Array:
        """Least and greatest east and north of the points, shape (2, 2) [m]."""
        return np.array([[pick(self.east), pick(self.north)] for pick in (np.min, np.max)])

    def steps(self, axis: int) -> Array:
        """Return the distances [m] between neighbours along an axis, shape (J - 1, I) or (J, I - 1)."""
        return np.hypot(np.diff(self.east, axis=axis), np.diff(self.north, axis=axis))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Ensemble:
    """Forecast members on one grid; a truth is an ensemble of one.

    Attributes:
        grid: Grid of the members.
        velocity: shape (E, 2, Z, J, I) [m/s], along the local axes; NaN where dry; in the file's precision; on disk if larger than memory.
        time_ns: Time [ns, UTC]; None if the file gives none.
        source: Path of the file, with ``#member`` if one was chosen.
        notes: Notes for the user on how it was read.
        members: Source of each member; empty if not read.
        representation_error_std: Error of each component added for ambiguous labels [m/s].
        made_from: ``lags``, ``times`` or ``models`` where the members' spread is not their error.
    """

    grid: Grid
    velocity: Values
    time_ns: int | None
    source: str
    notes: tuple[str, ...] = ()
    members: tuple[str, ...] = ()
    representation_error_std: float = 0.0
    made_from: str = ""

    def __repr__(self) -> str:
        """Return source, size, time and grid as text."""
        speed = self.component_rms
        first = f"Ensemble of {self.n_members} members from {self.source}, {time_text(self.time_ns)}, RMS component speed {speed:.3f} m/s"
        return f"{first}\n  {self.grid}"

    @property
    def n_members(self) -> int:
        """Number of members E."""
        return int(self.velocity.shape[0])

    @property
    def component_rms(self) -> float:
        """Root mean square of a component over all members and wet points [m/s]."""
        return component_rms(self.velocity)

    def rows(self, start: int, stop: int, level: int | None = None) -> Array:
        """Return a copy of the velocities in some rows of the grid, shape (E, 2, Z, rows, I).

        Args:
            start: First row.
            stop: After the last row.
            level: Index of a single level, Z = 1; None for all.
        """
        levels = slice(None) if level is None else slice(level, level + 1)
        copy = np.array(self.velocity[:, :, levels, start:stop], dtype=np.float64)
        release(self.velocity)
        return copy


def component_rms(velocity: Values) -> float:
    """Return the root mean square of a component [m/s] over ``velocity``, shape (E, ...), NaN where dry."""
    square, count = 0.0, 0
    for member in one_by_one(velocity):
        wet = member[np.isfinite(member)]
        square, count = square + float(wet @ wet), count + wet.size
    return float(np.sqrt(square / count)) if count else float("nan")


@dataclass(frozen=True, slots=True, eq=False)
class Seabed:
    """Depth of the bottom on a regular grid of the local frame.

    Attributes:
        east: shape (I,) [m], cell centres, evenly spaced.
        north: shape (J,) [m], cell centres, evenly spaced.
        depth: shape (J, I) [m], positive down; 0 or less on land, NaN if unknown.
    """

    east: Array
    north: Array
    depth: Array
