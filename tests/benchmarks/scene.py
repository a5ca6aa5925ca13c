"""An ensemble of the paper's size, its truth, and pings along a glider's track, at scattered places or of a long survey."""

from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.geodesy import to_geographic, to_local
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Observation
from replay_kit.forecast.grid import local_grid, true_to_local
from replay_kit.studies.twins.adcp import AdcpSettings, measure
from replay_kit.studies.twins.ensemble import CENTRE, Eddies, Jet, velocity
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.glider import mission
from replay_kit.studies.twins.vehicle import EPOCH_NS, Pings
from tests import synthetic

LEVELS = np.array([5.0, 50.0, 100.0, 200.0, 300.0, 400.0, 550.0, 750.0])
CELLS = (0.106, 0.081)  # degrees, about 9 km
# As forecasts are packed [m/s]: without it smooth members have fewer directions than there are slices.
PACKED = 1e-4
NOISE = 0.09  # m/s
BINS = 16.0 + 32.0 * np.arange(22)


@dataclass(frozen=True)
class Size:
    """How large a scene is; the paper's by default."""

    rows: int = 17
    columns: int = 31
    levels: int = 8
    members: int = 95
    bins: int = 22


TINY = Size(5, 6, 3, 6, 8)


def ensemble(size: Size, seed: int = 0) -> tuple[Ensemble, Ensemble]:
    """Return the ensemble and the truth withheld from it."""
    rng = np.random.default_rng(seed)
    axis = [np.arange(n) - 0.5 * (n - 1) for n in (size.columns, size.rows)]
    longitude, latitude = np.meshgrid(
        CENTRE.longitude + CELLS[0] * axis[0], CENTRE.latitude + CELLS[1] * axis[1]
    )
    east, north = to_local(CENTRE, longitude, latitude)
    half = np.array([east.max(), north.max()])
    levels = LEVELS[: size.levels]
    common = _eddies(rng, half, 12, 0.4)
    jet = Jet(0.3, rng.uniform(-2e4, 2e4), 2e4, 1.4e4, 1.3e5, 1.0, rng.normal(0.0, 8.0), 500.0)
    members = []
    for _ in range(size.members + 1):
        moved = replace(common, centre=common.centre + rng.normal(0.0, 1.2e4, common.centre.shape))
        own = _eddies(rng, half, 12, 0.15)
        meander = replace(
            jet, axis=jet.axis + rng.normal(0.0, 8e3), phase=jet.phase + rng.normal(0.0, 0.4)
        )
        members.append(
            np.stack(velocity((moved, own), meander, east, north, levels[:, None, None]))
        )
    packed = PACKED * np.round(np.array(members) / PACKED)
    wet = np.ones(packed.shape[2:], dtype=bool)
    grid = local_grid(longitude, latitude, levels, wet, None)
    values = true_to_local(grid.projection, longitude, latitude, packed)
    return Ensemble(grid, values[1:], None, "benchmark"), Ensemble(
        grid, values[:1], None, "benchmark's truth"
    )


def _eddies(rng: np.random.Generator, half: np.ndarray, count: int, speed: float) -> Eddies:
    return Eddies(
        rng.uniform(-1.0, 1.0, (count, 2)) * half,
        rng.normal(0.0, 15.0, (count, 2)),
        rng.uniform(1.5e4, 3.5e4, count),
        rng.choice([-1.0, 1.0], count) * rng.uniform(0.5, 1.0, count) * speed,
        rng.uniform(150.0, 900.0, count),
    )


def track(truth: Ensemble, n: int, size: Size, seed: int = 1) -> list[Observation]:
    """Return pings along a glider's course, one every ten minutes, each seen from the surface so that every bin is in the grid."""
    flown = mission(build_field(truth), n, EPOCH_NS, np.random.default_rng(seed)).pings
    return _observed(truth, np.column_stack([flown.east, flown.north])[:n], size, seed)


def scattered(truth: Ensemble, n: int, size: Size, seed: int = 2) -> list[Observation]:
    """Return pings at random places."""
    return _observed(
        truth, _inside(truth, np.random.default_rng(seed).uniform(-1.0, 1.0, (n, 2))), size, seed
    )


def survey(truth: Ensemble, n: int, size: Size, seed: int = 3, legs: int = 40) -> list[Observation]:
    """Return pings along parallel legs over the whole region, there and back."""
    along = np.linspace(0.0, legs, n)
    leg = np.minimum(np.floor(along), legs - 1)
    fraction = along - leg
    east = np.where(leg % 2 == 0, 2.0 * fraction - 1.0, 1.0 - 2.0 * fraction)
    return _observed(
        truth,
        _inside(truth, np.column_stack([east, 2.0 * (leg + fraction) / legs - 1.0])),
        size,
        seed,
    )


def _inside(truth: Ensemble, fractions: np.ndarray) -> np.ndarray:
    low = np.array([truth.grid.east.min(), truth.grid.north.min()])
    high = np.array([truth.grid.east.max(), truth.grid.north.max()])
    return 0.5 * (low + high) + 0.46 * (high - low) * fractions


def _observed(truth: Ensemble, places: np.ndarray, size: Size, seed: int) -> list[Observation]:
    n = len(places)
    depth = (
        BINS[: size.bins]
        if size.bins == BINS.size
        else np.linspace(BINS[0], truth.grid.levels[-1] - 1.0, size.bins)
    )
    step = float(depth[1] - depth[0])
    pings = Pings(np.arange(n), places[:, 0], places[:, 1], np.zeros(n), np.zeros(n), np.zeros(n))
    values = measure(
        build_field(truth),
        pings,
        AdcpSettings(size.bins, step, float(depth[0]), NOISE),
        np.random.default_rng(seed),
    )
    longitude, latitude = to_geographic(truth.grid.projection, places[:, 0], places[:, 1])
    like = synthetic.profile(truth.grid, 0.0, 0.0, depth, np.zeros((depth.size, 2)), NOISE)
    return [
        replace(
            like,
            longitude=float(longitude[i]),
            latitude=float(latitude[i]),
            velocity=values[i],
            time_ns=i,
        )
        for i in range(n)
    ]
