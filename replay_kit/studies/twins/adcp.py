"""A simulated ADCP: what it measures below each ping, with its faults, and profiles of it at random places or at all grid points."""

from dataclasses import dataclass

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_geographic, to_geographic
from replay_kit.core.grid import Ensemble, Projection
from replay_kit.core.observation import Flag, Observation, Reason, Reference, Source
from replay_kit.studies.twins.field import Field
from replay_kit.studies.twins.vehicle import EPOCH_NS, Pings, random_places

OUTLIER = 1.0  # m/s
# each kind of error has draws of its own, so that one option does not change what another draws
_PLATFORM_DRAWS, _OUTLIER_DRAWS = 1, 2


@dataclass(frozen=True, slots=True)
class AdcpSettings:
    """A down-looking instrument.

    Attributes:
        n_cells: Number of bins.
        cell_size: [m].
        bin0_distance: Transducer to the centre of the first bin [m].
        noise: Standard deviation of each component [m/s].
    """

    n_cells: int = 22
    cell_size: float = 32.0
    bin0_distance: float = 16.0
    noise: float = 0.09


def measure(field: Field, pings: Pings, settings: AdcpSettings, rng: np.random.Generator) -> Array:
    """Return what each bin of each ping measures, shape (n_pings, n_cells, 2) [m/s], true east and true north.

    NaN where the truth has no water: below its last level, on land, outside its grid.

    Args:
        field: The truth.
        pings: Where the instrument is.
        settings: The instrument.
        rng: Source of the noise; each bin takes its draws whether it is wet or not, so that one bin's noise does not depend on
            another's water.
    """
    below = settings.bin0_distance + settings.cell_size * np.arange(settings.n_cells)
    velocity = field.velocity(
        pings.east[:, None],
        pings.north[:, None],
        pings.depth[:, None] + below,
        pings.time_ns[:, None],
    )
    longitude, latitude = to_geographic(field.grid.projection, pings.east, pings.north)
    east, north = rotate_to_geographic(
        field.grid.projection,
        longitude[:, None],
        latitude[:, None],
        velocity[..., 0],
        velocity[..., 1],
    )
    noise = rng.standard_normal(velocity.shape)
    return np.stack([east, north], axis=-1) + settings.noise * noise


@dataclass(frozen=True, slots=True)
class Faults:
    """How what is logged differs from the current over the ground with the instrument's noise.

    Attributes:
        reference: What the logged velocities are relative to.
        platform_std: Error of each component of the platform's velocity, which the pings then state [m/s]; None: they do not.
        heading_bias_deg: Added to the heading, clockwise: what is measured relative to the platform is turned by it.
        scale_error: Share by which what is measured relative to the platform is too large.
        outliers: Share of pings whose bins are all off by 1 m/s in one random direction.
    """

    reference: Reference = "earth"
    platform_std: float | None = None
    heading_bias_deg: float = 0.0
    scale_error: float = 0.0
    outliers: float = 0.0

    def check(self) -> None:
        """Raise ConfigError when a number is none that can be simulated."""
        if self.platform_std is not None and (
            self.reference != "platform" or not 0.0 < self.platform_std < np.inf
        ):
            raise ConfigError(
                f"twin: a platform's velocity goes with reference platform and an error above 0, got {self.platform_std}"
            )
        if not (
            np.isfinite(self.heading_bias_deg)
            and np.isfinite(self.scale_error)
            and 0.0 <= self.outliers <= 1.0
        ):
            raise ConfigError(
                "twin: expected a finite heading bias and scale error and outliers of 0 to 1, "
                f"got {self.heading_bias_deg}, {self.scale_error} and {self.outliers}"
            )


#: An instrument without faults.
SOUND = Faults()


def as_logged(
    velocity: Array, pings: Pings, projection: Projection, faults: Faults, seed: int
) -> tuple[Array, Array | None]:
    """Return velocities as the instrument logs them, and the platform's velocity that it states, shape (n, 2), or None.

    Args:
        velocity: shape (n, n_cells, 2) [m/s], of the water over the ground with noise, true east and north.
        pings: Where, and how the platform moved.
        projection: The local frame of the pings.
        faults: What is wrong.
        seed: Of the outliers and of the error of the platform's velocity.
    """
    if faults == SOUND:
        return velocity, None
    assert pings.velocity is not None, "missions know how their vehicle moves"
    longitude, latitude = to_geographic(projection, pings.east, pings.north)
    platform = np.column_stack(
        rotate_to_geographic(
            projection, longitude, latitude, pings.velocity[:, 0], pings.velocity[:, 1]
        )
    )
    bias = np.deg2rad(faults.heading_bias_deg)
    clockwise = np.array([[np.cos(bias), -np.sin(bias)], [np.sin(bias), np.cos(bias)]])
    logged = (1.0 + faults.scale_error) * (velocity - platform[:, None]) @ clockwise
    logged = logged + _outliers(len(velocity), faults.outliers, seed)[:, None]
    if faults.reference == "earth":
        return logged + platform[:, None], None
    if faults.platform_std is None:
        return logged, None
    error = np.random.default_rng([seed, _PLATFORM_DRAWS]).standard_normal(platform.shape)
    return logged, platform + faults.platform_std * error


def _outliers(n: int, share: float, seed: int) -> Array:
    """Return what is added to each of n pings, shape (n, 2) [m/s]; the share is that of the pings, rounded."""
    rng = np.random.default_rng([seed, _OUTLIER_DRAWS])
    chosen, direction = rng.permutation(n)[: round(share * n)], rng.uniform(0.0, 2.0 * np.pi, n)
    offset = np.zeros((n, 2))
    offset[chosen] = OUTLIER * np.column_stack([np.cos(direction), np.sin(direction)])[chosen]
    return offset


# Error stated by an instrument without noise: the paper's in ideal conditions [m/s].
IDEAL_ERROR_STD = 0.01
_INTERVAL_NS = 60_000_000_000


def random_observations(
    field: Field, pings: int, noise: float, seed: int
) -> tuple[Observation, ...]:
    """Return profiles, 22 bins of 32 m from 16 m each, at places uniformly random over the truth's wet surface.

    Args:
        field: The truth.
        pings: Number of profiles.
        noise: Standard deviation of each component of each bin [m/s]; the profiles state it as their error.
        seed: Of the places and of the noise.

    Raises:
        ForecastError: Hardly any of the truth's surface is wet.
    """
    rng = np.random.default_rng(seed)
    places = random_places(field, pings, rng)
    settings = AdcpSettings(noise=noise)
    time_ns = EPOCH_NS + _INTERVAL_NS * np.arange(pings)
    nothing = np.zeros(pings)
    velocity = measure(
        field, Pings(time_ns, places[:, 0], places[:, 1], nothing, nothing, nothing), settings, rng
    )
    depth = settings.bin0_distance + settings.cell_size * np.arange(
        settings.n_cells, dtype=np.float64
    )
    longitude, latitude = to_geographic(field.grid.projection, places[:, 0], places[:, 1])
    error_std = noise if noise > 0.0 else IDEAL_ERROR_STD
    return _observations((longitude, latitude), depth, velocity, error_std)


def grid_observations(truth: Ensemble) -> tuple[Observation, ...]:
    """Return the paper's ideal measurements: each wet grid point once, without noise, a profile for each column of grid points.

    Args:
        truth: An ensemble of one; the bins are at its levels.
    """
    grid = truth.grid
    j, i = np.nonzero(grid.wet[0])
    longitude, latitude = grid.longitude[j, i], grid.latitude[j, i]
    u, v = truth.velocity[0][:, :, j, i]
    velocity = np.stack(rotate_to_geographic(grid.projection, longitude, latitude, u, v), axis=-1)
    return _observations(
        (longitude, latitude), grid.levels, np.moveaxis(velocity, 1, 0), IDEAL_ERROR_STD
    )


def _observations(
    places: tuple[Array, Array], depth: Array, velocity: Array, error_std: float
) -> tuple[Observation, ...]:
    """Return profiles, one a minute, at longitudes and latitudes, of velocities of shape (n, depths, 2) that are NaN where missing."""
    missing = np.asarray(~np.isfinite(velocity).all(axis=2))
    return tuple(
        Observation(
            time_ns=EPOCH_NS + _INTERVAL_NS * k,
            longitude=float(longitude),
            latitude=float(latitude),
            depth=depth,
            velocity=velocity[k],
            error_std=np.full(depth.size, error_std),
            reference="earth",
            flags=np.where(missing[k], Flag.MISSING, Flag.GOOD).astype(np.int8),
            reasons=np.where(missing[k], Reason.MISSING, Reason.NONE).astype(np.int32),
            dive=0,
            source=Source(0, "/adcp", k, EPOCH_NS + _INTERVAL_NS * k),
        )
        for k, (longitude, latitude) in enumerate(zip(*places, strict=True))
    )
