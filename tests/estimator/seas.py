"""Small seas whose members drift, and measurements of every kind in them; what they measure is noise, as linear algebra does not mind."""

from dataclasses import replace

import numpy as np

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.grid import Ensemble
from replay_kit.core.observation import Label, LinearMeasurement, PathMean, Source
from tests import synthetic

HOUR = 3600 * 10**9
DAY = 24 * HOUR
LEVELS = np.array([5.0, 90.0, 220.0])
CONFIG = EstimatorConfig(modes=12, sample_share=0.6, mean_variance=0.1, spread="as_given")


def forecasts(n_times=3, n_members=6, days=4.0):
    """An ensemble whose members drift from what they are to something else, more and more."""
    first, last = (
        synthetic.ensemble(seed, n_members=n_members, shape=(4, 5), levels=LEVELS)
        for seed in (0, 50)
    )
    shares = np.linspace(0.0, 1.0, n_times) if n_times > 1 else [0.0]
    return [
        Ensemble(
            first.grid,
            (0.5 + share) * (np.cos(share) * first.velocity + np.sin(share) * last.velocity),
            int(share * days * DAY),
            "synthetic",
        )
        for share in shares
    ]


(SEA,) = forecasts(1)
GRID = SEA.grid


def profiles(n, days=4.0, seed=2):
    return [
        replace(each, time_ns=int((k + 0.5) * days * DAY / n))
        for k, each in enumerate(synthetic.random_profiles(GRID, n, seed, speed=0.1))
    ]


def relative(profile):
    """The profile, of a platform of unknown velocity."""
    return replace(profile, common_std=np.inf, reference="platform")


def path(rng, n=7):
    """Places and times of a dive along a crooked way."""
    east = np.linspace(*rng.uniform(0.6 * GRID.east.min(), 0.6 * GRID.east.max(), 2), n)
    north = np.linspace(*rng.uniform(0.6 * GRID.north.min(), 0.6 * GRID.north.max(), 2), n)
    weight = rng.uniform(0.2, 1.0, n)
    return to_geographic(
        GRID.projection, east, north + rng.normal(0, 500.0, n)
    ), weight / weight.sum()


def dive(start_ns=0, seed=0):
    """A mean current over a dive of three hours."""
    (longitude, latitude), weight = path(np.random.default_rng(seed))
    times = start_ns + (np.cumsum(weight) * 3 * HOUR).astype(np.int64)
    depth = 200.0 * (1.0 - np.abs(np.linspace(-1.0, 1.0, weight.size)))
    end, source = int(times[-1]), Source(0, "/dac", seed, 0)
    return PathMean(
        end, times, longitude, latitude, depth, weight, (0.1, -0.05), 0.02, "dac", 1, source
    )


def radials(time_ns, n=3, components=((0.6, 0.8),)):
    """Averages over boxes of surface currents along a direction, whose errors are correlated."""
    rng = np.random.default_rng(n)
    (longitude, latitude), _ = path(rng, 4 * n)
    return linear(
        time_ns,
        longitude=longitude,
        latitude=latitude,
        depth=np.ones(4 * n),
        weights=np.kron(np.eye(n), rng.dirichlet(np.ones(4))),
        value=0.2 * rng.standard_normal((n, len(components))),
        error_std=rng.uniform(0.05, 0.1, n),
        components=np.array(components),
        common_std=0.03,
        correlation=0.5 + 0.5 * np.eye(n),
    )


def shear(time_ns):
    """Differences in depth of the current through a section, known up to a constant."""
    depth = np.arange(10.0, 200.0, 20.0)
    return linear(
        time_ns,
        longitude=np.array([152.25]),
        latitude=np.array([-39.8]),
        depth=depth,
        weights=None,
        value=0.05 * np.random.default_rng(0).standard_normal((depth.size, 1)),
        error_std=np.full(depth.size, 0.02),
        components=np.array([[0.8, -0.6]]),
        common_std=np.inf,
        correlation=np.exp(-np.abs(depth[:, None] - depth) / 50.0),
    )


def linear(time_ns, **parts):
    n = len(parts["value"])
    label = Label(0, Source(0, "/other", 1, time_ns))
    flags, reasons = np.ones(n, np.int8), np.zeros(n, np.int32)
    return LinearMeasurement(time_ns, None, flags=flags, reasons=reasons, label=label, **parts)


def every_kind():
    """One measurement of each kind, in order of time, four days in all."""
    plain, alike, shared, unknown = profiles(4)
    return [
        plain,
        dive(plain.time_ns + HOUR),
        replace(alike, correlation_depth=40.0),
        radials(alike.time_ns + HOUR),
        replace(shared, common_std=0.05),
        radials(shared.time_ns + HOUR, 2, ((1.0, 0.0), (0.0, 1.0))),
        replace(dive(shared.time_ns + 8 * HOUR, 1).linear, label=Label(0, plain.source)),
        relative(unknown),
        shear(unknown.time_ns + HOUR),
    ]
