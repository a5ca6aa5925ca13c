"""The example of another sensor: radials of an HF radar, as a user would add them, without a change of the program."""

import heapq
from pathlib import Path

import numpy as np
import pytest

from replay_kit.config.gating import GatingConfig
from replay_kit.config.run import EstimatorConfig
from replay_kit.config.time import TimeConfig
from replay_kit.core.errors import LogError
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Flag, Source
from replay_kit.estimator import build_estimator
from replay_kit.estimator.evolving import build_evolving
from replay_kit.workflows.replay.stages.estimation import EstimationState, assimilate
from tests import synthetic
from tests.places import DATA, SAMPLES
from tests.reference import estimator as slow

OCEAN = synthetic.ensemble(levels=np.array([5.0, 65.0, 165.0]))
CONFIG = EstimatorConfig(modes=8, mean_variance=0.0)
HEADER = """%FileType: LLUV rdls "RadialMap"
%TimeStamp: 2019 01 01  03 00 00
%TransmitCenterFreqMHz: 13.450000
%TableColumnTypes: LOND LATD VELU VELV VFLG ETMP VELO HEAD
"""
ROWS = """   {0:.4f} {1:.4f}   0.0 -10.0   0   5.0   10.0  180.0
   {0:.4f} {1:.4f}   0.0 -10.0 128   5.0   10.0  180.0
   {0:.4f} {1:.4f}   0.0 -10.0   0 999.0   10.0  180.0
"""


@pytest.fixture
def radar(monkeypatch):
    """The example's folder on the path, as a user's own package is."""
    monkeypatch.syspath_prepend(str(SAMPLES / "examples"))
    from hf_radar import lluv, radial

    return radial.radial, lluv.read_radials


def radials(radial, count=12):
    """Of places and directions at random."""
    rng, profiles = np.random.default_rng(4), synthetic.random_profiles(OCEAN.grid, count, seed=2)
    return [
        radial(
            Source(0, "radar", k, profile.time_ns),
            (profile.longitude, profile.latitude),
            rng.uniform(0.0, 360.0),
            0.2 * rng.standard_normal(),
            0.04,
            20.0,
        )
        for k, profile in enumerate(profiles)
    ]


def row_of(estimator, measurement):
    """Design and value about the offset by flows of one mode each, and the error with that of the basis."""
    longitude, latitude = measurement.longitude[0], measurement.latitude[0]
    east, north = to_local(OCEAN.grid.projection, longitude, latitude)
    along = np.array(
        rotate_to_local(OCEAN.grid.projection, longitude, latitude, *measurement.components[0])
    )
    size = estimator.prior.mean.size

    def speed(weights):
        flow = estimator.flow_of(weights, np.empty((0, 0)), None)
        return flow.velocity(east, north, measurement.depth[0]) @ along

    offset = speed(np.zeros(size))
    design = np.array([speed(one) - offset for one in np.eye(size)])
    of_levels = estimator.basis.local_error(
        np.array([[east, north]]), estimator.representation_std
    )[0]
    std = np.hypot(0.04, np.interp(measurement.depth[0], OCEAN.grid.levels, of_levels))
    return design[None], measurement.value[0] - offset, std


def test_the_estimate_is_that_of_the_dense_kalman_update(radar):
    estimator = build_estimator(OCEAN, CONFIG)
    state, mean, cov = estimator.initial(), estimator.prior.mean, estimator.prior.covariance()
    for measurement in radials(radar[0]):
        design, value, std = row_of(estimator, measurement)
        expected = value - design @ mean
        mean, cov, nis, _ = slow.kalman_update(mean, cov, design, value, std**2 * np.eye(1))
        state, said = estimator.step(state, measurement)
        assert (said.dof, said.accepted) == (1, True)
        assert said.nis == pytest.approx(nis, rel=1e-9)
        np.testing.assert_allclose(np.hypot(*said.innovation[0]), abs(expected[0]), atol=1e-12)
    np.testing.assert_allclose(state.mean, mean, atol=1e-12 * np.abs(mean).max())
    np.testing.assert_allclose(state.posterior.covariance(), cov, atol=1e-12 * np.abs(cov).max())


def test_through_time_without_change_the_estimate_is_the_static_one(radar):
    static = build_estimator(OCEAN, CONFIG)
    evolving = build_evolving([OCEAN], CONFIG, TimeConfig(scale="static", dropped_std=0.0))
    state, other = static.initial(), evolving.initial()
    for measurement in radials(radar[0], 5):
        state, said = static.step(state, measurement)
        other, same = evolving.step(other, measurement)
        assert same.nis == pytest.approx(said.nis, rel=1e-9)
    np.testing.assert_allclose(evolving.weights([other])[0], state.mean, atol=1e-10)


def test_radials_and_profiles_that_are_grouped_are_one_stream(radar):
    estimator = build_estimator(OCEAN, CONFIG, GatingConfig())
    both = heapq.merge(
        radials(radar[0]),
        synthetic.random_profiles(OCEAN.grid, 12, seed=3),
        key=lambda measurement: measurement.time_ns,
    )
    begun = EstimationState(estimator.initial(), estimator.initial())
    _, steps = assimilate(estimator, begun, list(both))
    assert len(steps) == 24
    assert all(np.isfinite(step.weights).all() for step in [s.assimilation for s in steps])


def test_a_file_s_radials_have_its_time_its_depth_and_its_flags(radar, tmp_path):
    path = tmp_path / "one.ruv"
    path.write_text(HEADER + ROWS.format(152.4, -40.1))
    good, rejected, unknown = radar[1](path)
    assert good.time_ns == 1546311600000000000
    assert good.value == pytest.approx(0.1)
    np.testing.assert_allclose(good.components, [[0.0, -1.0]], atol=1e-12)
    assert good.depth == pytest.approx(0.887, abs=1e-3)
    assert [each.flags[0] for each in (good, rejected, unknown)] == [
        Flag.GOOD,
        Flag.FAIL,
        Flag.FAIL,
    ]
    path.write_text(HEADER.replace("HEAD", "BEAR"))
    with pytest.raises(LogError, match="lacks HEAD"):
        list(radar[1](path))


def test_a_real_station_s_radials_are_read(radar):
    path = Path(DATA / "hfradar" / "RDLi_SEAB_2019_01_01_0000.ruv")
    if not path.exists():
        pytest.skip("the radar's file is not there")
    found = list(radar[1](path))
    assert len(found) == 745
    rows = np.array([row.split() for row in path.read_text().splitlines() if row[0] != "%"], float)
    vectors = np.array([each.value[0, 0] * each.components[0] for each in found])
    # directions have one decimal of a degree
    np.testing.assert_allclose(vectors, 1e-2 * rows[:, 2:4], atol=1e-3)
