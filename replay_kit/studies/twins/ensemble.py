"""Synthetic ensemble: eddies and a meandering jet, incompressible by construction, surface-intensified.

Each member is the curl of a stream function, so its horizontal divergence is zero everywhere and at every depth. Members perturb a common
draw, as forecast members share an analysis; the truth is one more member.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from replay_kit.core.arrays import Array, points_over
from replay_kit.core.errors import ConfigError
from replay_kit.core.files.atomic import write_whole
from replay_kit.core.files.paths import check_paths
from replay_kit.core.flow.dataset import described_dataset
from replay_kit.core.geodesy import rotate_to_geographic, to_local
from replay_kit.core.grid import Projection

CENTRE = Projection(152.5, -40.0)
LEVELS = np.array([5.0, 50.0, 150.0, 300.0, 500.0, 750.0])
LATITUDES = CENTRE.latitude + 0.081 * np.arange(-6.0, 7.0)  # about 9 km
LONGITUDES = CENTRE.longitude + 0.106 * np.arange(-10.0, 11.0)  # about 9 km at 40 S
TIME = np.datetime64("2018-11-16T00:00:00", "ns")
_AXES = (
    ("depth", "m", "Z", LEVELS),
    ("latitude", "degrees_north", "Y", LATITUDES),
    ("longitude", "degrees_east", "X", LONGITUDES),
)
_HALF_WIDTH = np.array([90_000.0, 54_000.0])  # m, of the grid
_LATTICE = np.array([4, 2])  # columns and rows that the common eddies are scattered about
_OWN_EDDIES = 3
_PACKED = {"dtype": "int16", "scale_factor": 1e-4, "_FillValue": np.int16(-32768)}  # to 3.2 m/s
_HOURS = {"dtype": "int32", "units": "hours since 1970-01-01 00:00:00", "calendar": "standard"}

#: Parameters of eddies or of the jet: numbers, or arrays with a row per eddy.
Parameters = Sequence[Any]
# What a member changes of each parameter: standard deviation of what is added or, where True, of the logarithm of a factor.
# Eddies: centre [m], its shift per metre of depth, radius of the greatest speed [m], that speed [m/s], its e-folding depth [m].
_EDDIES = (10_000.0, False), (6.0, False), (0.12, True), (0.22, True), (0.2, True)
# The jet: speed on its axis [m/s]; northing of the axis, width, amplitude and wavelength of the meander [m]; its phase [rad]; shift of the
# axis per metre of depth; e-folding depth of the speed [m].
_JET = (
    *((0.2, True), (7_000.0, False), (0.1, True), (0.25, True), (0.05, True)),
    *((0.4, False), (4.0, False), (0.15, True)),
)


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
    eddies, jet = common_draw(rng)
    longitude, latitude = np.meshgrid(LONGITUDES, LATITUDES)
    place = *to_local(CENTRE, longitude, latitude), LEVELS[:, None, None]
    members = []
    for _ in range(n_members + 1):
        centre = rng.uniform(-1.0, 1.0, (_OWN_EDDIES, 2))
        eddies_of_member = _draw_eddies(centre, 0.16 * rng.choice([-1.0, 1.0], _OWN_EDDIES), rng)
        groups = _perturbed(eddies, _EDDIES, rng), eddies_of_member
        local = velocity(groups, _perturbed(jet, _JET, rng), *place)
        members.append(rotate_to_geographic(CENTRE, longitude, latitude, *local))
    values = np.array(members)
    return _dataset(values[1:], seed, "ensemble"), _dataset(values[0], seed, "truth")


def velocity(
    groups: Iterable[Parameters], jet: Parameters, east: Array, north: Array, depth: Array
) -> tuple[Array, Array]:
    """Return local east and north velocity [m/s], u = dpsi/dy, v = -dpsi/dx of the stream function.

    An eddy is psi = -speed radius exp(1/2 - r^2 / (2 radius^2)), the jet psi = speed width tanh((y - axis(x)) / width), each with
    exponential decay in depth.

    Args:
        groups: Parameters of some eddies; speeds are positive anticlockwise.
        jet: Parameters of the jet.
        east: [m], local frame; the coordinates are broadcast against each other.
        north: [m], local frame.
        depth: [m], positive down.
    """
    speed, northing, width, amplitude, wavelength, phase, tilt, decay = jet
    k = 2.0 * np.pi / wavelength
    axis = northing + tilt * depth + amplitude * np.sin(k * east + phase)
    u = speed * np.exp(-depth / decay) / np.cosh((north - axis) / width) ** 2
    v = u * amplitude * k * np.cos(k * east + phase)
    for eddies in groups:
        for centre, tilt, radius, speed, decay in zip(*eddies, strict=True):
            dx, dy = east - centre[0] - tilt[0] * depth, north - centre[1] - tilt[1] * depth
            swirl = (
                speed / radius * np.exp(0.5 - (dx**2 + dy**2) / (2.0 * radius**2) - depth / decay)
            )
            u, v = u - swirl * dy, v + swirl * dx
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
    encoding: dict[str, Any] = {"uo": _PACKED, "vo": _PACKED, "time": _HOURS | {"_FillValue": None}}
    for path, dataset in zip((ensemble, truth), pair, strict=True):
        written = dataset.to_netcdf(None, format="NETCDF3_64BIT", engine="scipy", encoding=encoding)
        write_whole(path, bytes(written))
    return pair


def common_draw(rng: np.random.Generator) -> tuple[Parameters, Parameters]:
    """Return the eddies and the jet that all members perturb.

    The eddies are near a lattice with alternating rotation, so that they do not accumulate.
    """
    lattice = points_over(*(np.arange(count, dtype=np.float64) for count in _LATTICE))
    turn = np.where(lattice.sum(axis=1) % 2 == 0, 1.0, -1.0) * rng.choice([-1.0, 1.0])
    off = rng.uniform(-0.35, 0.35, lattice.shape) * (2.0 / _LATTICE)
    eddies = _draw_eddies((2.0 * lattice + 1.0) / _LATTICE - 1.0 + off, 0.42 * turn, rng)
    northing, phase = rng.uniform(-20_000.0, 20_000.0), rng.uniform(0.0, 2.0 * np.pi)
    tilt = rng.normal(0.0, 8.0)
    return eddies, (0.28, northing, 20_000.0, 14_000.0, 130_000.0, phase, tilt, 500.0)


def _draw_eddies(place: Array, speed: Array, rng: np.random.Generator) -> Parameters:
    """Return eddies at positions in half widths of the grid, shape (n, 2), with 50 to 100 % of the given speeds."""
    count = len(place)
    return (
        place * _HALF_WIDTH,
        rng.normal(0.0, 10.0, (count, 2)),
        rng.uniform(18_000.0, 30_000.0, count),
        rng.uniform(0.5, 1.0, count) * speed,
        rng.uniform(250.0, 900.0, count),
    )


def _perturbed(
    common: Parameters, changes: Iterable[tuple[float, bool]], rng: np.random.Generator
) -> Parameters:
    """Return a member's own parameters."""
    values = []
    for value, (std, is_factor) in zip(common, changes, strict=True):
        drawn = rng.normal(0.0, std, np.shape(value))
        values.append(value * np.exp(drawn) if is_factor else value + drawn)
    return values


def _dataset(values: Array, seed: int, what: str) -> xr.Dataset:
    """Return a CF dataset of values, shape ([members,] 2, Z, J, I)."""
    coordinates: dict[str, Any] = {"time": ((), TIME, {"standard_name": "time"})}
    for name, units, axis, points in _AXES:
        about = {"standard_name": name, "units": units}
        about |= {"positive": "down"} if axis == "Z" else {}
        about["axis"] = axis
        coordinates[name] = name, points, about
    dims = ["depth", "latitude", "longitude"]
    if values.ndim == 5:
        dims = ["member", *dims]
        numbers = np.arange(len(values), dtype=np.int32)
        coordinates["member"] = "member", numbers, {"standard_name": "realization", "units": "1"}
    variables = {}
    for name, direction, component in zip(
        ("uo", "vo"), ("eastward", "northward"), np.moveaxis(values, -4, 0), strict=True
    ):
        about = {"standard_name": f"{direction}_sea_water_velocity", "units": "m s-1"}
        variables[name] = dims, component, about
    return described_dataset(
        xr.Dataset(variables, coordinates),
        f"synthetic {what}: eddies and a meandering jet",
        f"synthesize, seed {seed}",
        {
            "summary": f"Synthetic {what}, no real ocean: eddies and a meandering jet, without horizontal divergence by construction.",
            "source": f"replay-kit synthesize, seed {seed}",
            "processing_level": "synthetic",
        },
    )
