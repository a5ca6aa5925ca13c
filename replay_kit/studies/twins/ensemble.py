"""Synthetic ensemble: eddies and a meandering jet, incompressible by construction, surface-intensified.

Each member is the curl of a stream function, so its horizontal divergence is zero everywhere and at every depth. Members perturb a common
draw, as forecast members share an analysis; the truth is one more member.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, TypeVar

import numpy as np
import xarray as xr

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.files.paths import check_paths
from replay_kit.core.flow.dataset import described
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Projection

LONGITUDES = 152.5 + 0.106 * np.arange(-10.0, 11.0)  # about 9 km at 40 S
LATITUDES = -40.0 + 0.081 * np.arange(-6.0, 7.0)  # about 9 km
LEVELS = np.array([5.0, 50.0, 150.0, 300.0, 500.0, 750.0])
CENTRE = Projection(152.5, -40.0)
TIME = np.datetime64("2018-11-16T00:00:00", "ns")

_HALF_WIDTH = np.array([90_000.0, 54_000.0])  # m, of the grid
_COLUMNS, _ROWS = 4, 2  # of the lattice that the common eddies are scattered about
_OWN_EDDIES = 3
_SCALE_FACTOR = 1e-4  # m/s; int16 then reaches 3.2 m/s


class Eddies(NamedTuple):
    """Gaussian eddies, one per entry.

    Attributes:
        centre: shape (n, 2) [m], local east and north at the surface.
        tilt: shape (n, 2), shift of the centre per metre of depth.
        radius: shape (n,) [m], radius of the greatest speed.
        speed: shape (n,) [m/s], greatest speed at the surface; positive anticlockwise.
        decay: shape (n,) [m], e-folding depth of the speed.
    """

    centre: Array
    tilt: Array
    radius: Array
    speed: Array
    decay: Array


class Jet(NamedTuple):
    """Eastward jet with a sinusoidal meander.

    Attributes:
        speed: Speed on the axis at the surface [m/s].
        axis: Mean northing of the axis [m].
        width: Width [m].
        amplitude: Amplitude of the meander [m].
        wavelength: Wavelength [m].
        phase: Phase [rad].
        tilt: Northward shift of the axis per metre of depth.
        decay: e-folding depth of the speed [m].
    """

    speed: float
    axis: float
    width: float
    amplitude: float
    wavelength: float
    phase: float
    tilt: float
    decay: float


_Kind = TypeVar("_Kind", Eddies, Jet)


def synthesize(seed: int = 0, n_members: int = 40) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the ensemble and the truth withheld from it, unpacked [m/s, true east and north].

    Args:
        seed: Seed of all draws.
        n_members: Number of members; the truth is drawn first from the same distribution, so that it does not depend on it.

    Raises:
        ConfigError: Fewer than two members, or a negative seed.
    """
    if n_members < 2 or seed < 0:
        raise ConfigError(
            f"synthetic ensemble: expected at least 2 members and a seed >= 0, got {n_members} and {seed}"
        )
    rng = np.random.default_rng(seed)
    eddies, jet = _draw_common_eddies(rng), _draw_jet(rng)
    longitude, latitude = np.meshgrid(LONGITUDES, LATITUDES)
    east, north = to_local(CENTRE, longitude, latitude)
    members = []
    for _ in range(n_members + 1):
        own = _draw_eddies(
            rng.uniform(-1.0, 1.0, (_OWN_EDDIES, 2)),
            rng.choice([-1.0, 1.0], _OWN_EDDIES) * 0.16,
            rng,
        )
        u, v = velocity(
            (_perturbed(eddies, _EDDIES, rng), own),
            _perturbed(jet, _JET, rng),
            east,
            north,
            LEVELS[:, None, None],
        )
        members.append(rotate_to_geographic(CENTRE, longitude, latitude, u, v))
    values = np.array(members)
    return _dataset(values[1:], seed, "ensemble"), _dataset(values[0], seed, "truth")


def velocity(
    groups: tuple[Eddies, ...], jet: Jet, east: Array, north: Array, depth: Array
) -> tuple[Array, Array]:
    """Return local east and north velocity [m/s], u = dpsi/dy, v = -dpsi/dx of the stream function.

    An eddy is psi = -speed radius exp(1/2 - r^2 / (2 radius^2)), the jet psi = speed width tanh((y - axis(x)) / width), each with
    exponential decay in depth.

    Args:
        groups: Eddies.
        jet: Jet.
        east: [m], local frame; the coordinates are broadcast against each other.
        north: [m], local frame.
        depth: [m], positive down.
    """
    k = 2.0 * np.pi / jet.wavelength
    axis = jet.axis + jet.tilt * depth + jet.amplitude * np.sin(k * east + jet.phase)
    profile = jet.speed * np.exp(-depth / jet.decay) / np.cosh((north - axis) / jet.width) ** 2
    u = profile
    v = profile * jet.amplitude * k * np.cos(k * east + jet.phase)
    for eddies in groups:
        for centre, tilt, radius, speed, decay in zip(*eddies, strict=True):
            dx, dy = east - centre[0] - tilt[0] * depth, north - centre[1] - tilt[1] * depth
            swirl = (
                speed / radius * np.exp(0.5 - (dx**2 + dy**2) / (2.0 * radius**2) - depth / decay)
            )
            u = u - swirl * dy
            v = v + swirl * dx
    return u, v


def write_ensemble(
    ensemble: Path, truth: Path, *, n_members: int = 40, seed: int = 0, overwrite: bool = False
) -> tuple[xr.Dataset, xr.Dataset]:
    """Write a synthetic ensemble and its truth as CF NetCDF-3 and return them; equal arguments give equal bytes.

    NetCDF-3 with packed 16-bit integers, as a NetCDF-4 file records library versions.

    Args:
        ensemble: File of the ensemble.
        truth: File of the truth.
        n_members: As in ``synthesize``.
        seed: As in ``synthesize``.
        overwrite: Whether existing files are replaced.

    Raises:
        ConfigError: A file exists or cannot be written, or an argument is invalid.
    """
    check_paths([], [ensemble, truth], overwrite)
    pair = synthesize(seed, n_members)
    packed: dict[str, object] = {
        "dtype": "int16",
        "scale_factor": _SCALE_FACTOR,
        "_FillValue": np.int16(-32768),
    }
    plain: dict[str, object] = {"dtype": "float64", "_FillValue": None}
    time: dict[str, object] = {
        "dtype": "int32",
        "units": "hours since 1970-01-01 00:00:00",
        "calendar": "standard",
        "_FillValue": None,
    }
    for path, dataset in ((ensemble, pair[0]), (truth, pair[1])):
        encoding = {
            "uo": packed,
            "vo": packed,
            "time": time,
            "depth": plain,
            "latitude": plain,
            "longitude": plain,
        }
        write_whole(
            path,
            bytes(
                dataset.to_netcdf(None, format="NETCDF3_64BIT", engine="scipy", encoding=encoding)
            ),
        )
    return pair


def _draw_common_eddies(rng: np.random.Generator) -> Eddies:
    """Return eddies near a lattice with alternating rotation, so that they do not accumulate."""
    column, row = (grid.ravel() for grid in np.meshgrid(np.arange(_COLUMNS), np.arange(_ROWS)))
    lattice = np.column_stack(
        [(2.0 * column + 1.0) / _COLUMNS - 1.0, (2.0 * row + 1.0) / _ROWS - 1.0]
    )
    spacing = np.array([2.0 / _COLUMNS, 2.0 / _ROWS])
    turn = np.where((column + row) % 2 == 0, 1.0, -1.0) * rng.choice([-1.0, 1.0])
    return _draw_eddies(
        lattice + rng.uniform(-0.35, 0.35, lattice.shape) * spacing, 0.42 * turn, rng
    )


def _draw_eddies(place: Array, speed: Array, rng: np.random.Generator) -> Eddies:
    """Return eddies at positions in half widths of the grid, shape (n, 2), with 50 to 100 % of the given speeds."""
    count = len(place)
    return Eddies(
        centre=place * _HALF_WIDTH,
        tilt=rng.normal(0.0, 10.0, (count, 2)),
        radius=rng.uniform(18_000.0, 30_000.0, count),
        speed=rng.uniform(0.5, 1.0, count) * speed,
        decay=rng.uniform(250.0, 900.0, count),
    )


def _draw_jet(rng: np.random.Generator) -> Jet:
    return Jet(
        speed=0.28,
        axis=rng.uniform(-20_000.0, 20_000.0),
        width=20_000.0,
        amplitude=14_000.0,
        wavelength=130_000.0,
        phase=rng.uniform(0.0, 2.0 * np.pi),
        tilt=rng.normal(0.0, 8.0),
        decay=500.0,
    )


# Standard deviations of what a member changes, in the order of the draws: of what is added, then of the logarithm of a factor.
_EDDIES = {
    "centre": (10_000.0, 0.0),
    "tilt": (6.0, 0.0),
    "radius": (0.0, 0.12),
    "speed": (0.0, 0.22),
    "decay": (0.0, 0.2),
}
_JET = {
    "speed": (0.0, 0.2),
    "axis": (7_000.0, 0.0),
    "width": (0.0, 0.1),
    "amplitude": (0.0, 0.25),
    "wavelength": (0.0, 0.05),
    "phase": (0.4, 0.0),
    "tilt": (4.0, 0.0),
    "decay": (0.0, 0.15),
}


def _perturbed(
    one: _Kind, spread: Mapping[str, tuple[float, float]], rng: np.random.Generator
) -> _Kind:
    """Return a member's own eddies or jet."""
    changes = {}
    for name, (added, factor) in spread.items():
        value = getattr(one, name)
        drawn = rng.normal(0.0, added + factor, np.shape(value))
        changes[name] = value * np.exp(drawn) if factor else value + drawn
    return one._replace(**changes)


def _dataset(values: Array, seed: int, what: str) -> xr.Dataset:
    """Return a CF dataset of values, shape ([members,] 2, Z, J, I)."""
    dims = (
        ("depth", "latitude", "longitude")
        if values.ndim == 4
        else ("member", "depth", "latitude", "longitude")
    )
    names = (("uo", "eastward"), ("vo", "northward"))
    variables = {
        name: (
            dims,
            np.take(values, axis, axis=-4),
            {"standard_name": f"{direction}_sea_water_velocity", "units": "m s-1"},
        )
        for axis, (name, direction) in enumerate(names)
    }
    coordinates = {
        "depth": (
            "depth",
            LEVELS,
            {"standard_name": "depth", "units": "m", "positive": "down", "axis": "Z"},
        ),
        "latitude": (
            "latitude",
            LATITUDES,
            {"standard_name": "latitude", "units": "degrees_north", "axis": "Y"},
        ),
        "longitude": (
            "longitude",
            LONGITUDES,
            {"standard_name": "longitude", "units": "degrees_east", "axis": "X"},
        ),
        "time": ((), TIME, {"standard_name": "time"}),
    }
    if values.ndim == 5:
        coordinates["member"] = (
            "member",
            np.arange(len(values), dtype=np.int32),
            {"standard_name": "realization", "units": "1"},
        )
    return described(
        xr.Dataset(variables, coordinates),
        f"synthetic {what}: eddies and a meandering jet",
        f"synthesize, seed {seed}",
        {
            "summary": f"Synthetic {what}, no real ocean: eddies and a meandering jet, without horizontal divergence by construction.",
            "source": f"replay-kit synthesize, seed {seed}",
            "processing_level": "synthetic",
        },
    )
