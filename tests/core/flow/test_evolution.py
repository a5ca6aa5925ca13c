"""How a flow changes with time, in memory and after it was saved."""

from dataclasses import replace

import h5netcdf
import numpy as np
import pytest

from replay_kit.core.errors import EstimatorError
from replay_kit.core.flow.evolution import Evolution, ProcessModel, constant, sample_through
from replay_kit.core.flow.load import load, load_bytes
from replay_kit.core.flow.lossless import save_bytes
from tests.core.flow.test_local import LOCAL
from tests.synthetic_flow import TIME_NS, synthetic_flow

HOUR = 3600 * 10**9
Z, R = 3, 4
AT = np.array([0.0, 2e3, -4e3]), np.array([0.0, -3e3, 5e3]), np.array([0.5, 60.0, 150.0])


def evolving(n_trajectories=5, n_local=2, time_ns=TIME_NS):
    """A flow of a random process with forecasts every six hours, two of them before the estimate's time."""
    rng = np.random.default_rng(4)
    still, times = synthetic_flow(n_modes=R), TIME_NS + HOUR * np.array([-8, -2, 4, 10])
    n = n_trajectories + n_local
    process = ProcessModel(
        times_ns=times,
        mean=rng.normal(size=(4, Z, R)),
        trajectories=rng.normal(size=(4, n_trajectories, Z, R)),
        spread=np.array([0.5, 1.0, 1.5, 2.5]),
        local=rng.normal(size=(n_local, Z, R)),
        trajectory_scale=50.0 * 3600.0,
        local_scale=10.0 * 3600.0,
    )
    factor = rng.normal(size=(n, n))
    cov = 0.05 * factor @ factor.T
    return Evolution(
        process, rng.normal(size=still.latent.shape), rng.normal(size=n), lambda: cov, time_ns
    ).flow(still, TIME_NS)


def assert_equal_flows(one, other):
    assert one.time_ns == other.time_ns
    np.testing.assert_array_equal(one.latent, other.latent)
    np.testing.assert_allclose(one.weight_cov, other.weight_cov, rtol=1e-13, atol=1e-15)


def test_six_hours_on_every_unknown_has_decayed_and_the_forecast_has_moved():
    flow = evolving()
    evolution = flow.later
    assert isinstance(evolution, Evolution)
    process, later = evolution.process, flow.at(TIME_NS + 6 * HOUR)
    # one third of the way from the forecast of 4 h to that of 10 h
    mean, trajectories, spread = (
        2 / 3 * x[2] + 1 / 3 * x[3] for x in (process.mean, process.trajectories, process.spread)
    )
    kept = np.exp(-6.0 / np.array([50.0] * 5 + [10.0] * 2))
    loading = np.concatenate([trajectories, spread * process.local]).reshape(7, -1)
    weights = mean.ravel() + (kept * evolution.mean) @ loading
    cov = np.outer(kept, kept) * evolution.covariance() + np.diag(1.0 - kept**2)
    np.testing.assert_allclose(
        later.latent, evolution.offset + flow.modes @ weights.reshape(Z, R).T, rtol=1e-12
    )
    np.testing.assert_allclose(later.weight_cov, loading.T @ cov @ loading, rtol=1e-11, atol=1e-13)
    assert later.time_ns == TIME_NS + 6 * HOUR
    # in one step or in two
    np.testing.assert_allclose(
        flow.at(TIME_NS + HOUR).at(TIME_NS + 6 * HOUR).weight_cov,
        later.weight_cov,
        rtol=1e-11,
        atol=1e-13,
    )


def test_before_its_last_observation_an_estimate_stays_as_it_is():
    flow = evolving()
    assert_equal_flows(flow.at(TIME_NS - HOUR), flow)
    assert_equal_flows(flow.at(TIME_NS), flow)


@pytest.mark.parametrize(("n_trajectories", "n_local"), [(5, 2), (0, 2), (5, 0)])
def test_a_saved_estimate_changes_with_time_as_in_memory(tmp_path, n_trajectories, n_local):
    flow = evolving(n_trajectories, n_local)
    flow.save(tmp_path / "flow.nc")
    loaded = load(tmp_path / "flow.nc")
    for hours in (-3, 0, 1, 6, 40):
        assert_equal_flows(loaded.at(TIME_NS + hours * HOUR), flow.at(TIME_NS + hours * HOUR))
    np.testing.assert_allclose(
        loaded.at(TIME_NS + HOUR).standard_error(*AT),
        flow.at(TIME_NS + HOUR).standard_error(*AT),
        rtol=1e-12,
    )
    assert np.abs(flow.at(TIME_NS + 6 * HOUR).velocity(*AT) - flow.velocity(*AT)).max() > 0.1
    # and is the same when it is saved again
    assert save_bytes(loaded) == save_bytes(flow)


def test_a_current_beside_it_is_not_taken_for_its_corrections():
    # the file has a dimension of the name that the corrections' array has
    flow = replace(evolving(n_local=0), local=LOCAL)
    loaded = load_bytes(save_bytes(flow), "flow")
    assert_equal_flows(loaded, flow)
    assert save_bytes(loaded) == save_bytes(flow)


def test_the_forecast_s_times_that_are_over_are_not_saved():
    flow = load_bytes(save_bytes(evolving()), "flow")
    assert isinstance(flow.later, Evolution)
    assert ((flow.later.process.times_ns - TIME_NS) // HOUR).tolist() == [-2, 4, 10]
    process = flow.later.process
    assert process.since(TIME_NS + 4 * HOUR).times_ns[0] == TIME_NS + 4 * HOUR
    assert process.since(TIME_NS + 4 * HOUR - 1).times_ns[0] == TIME_NS - 2 * HOUR
    assert process.since(TIME_NS - 90 * HOUR).times_ns.size == 3
    assert process.since(TIME_NS + 90 * HOUR).times_ns.tolist() == [TIME_NS + 10 * HOUR]


def test_a_forecast_alone_holds_at_any_time_also_after_it_was_saved():
    flow = replace(evolving(time_ns=None), time_ns=None)
    loaded = load_bytes(save_bytes(flow), "flow")
    assert loaded.time_ns is None
    for hours in (-7, 3, 9):
        before = flow.at(TIME_NS + hours * HOUR)
        assert before.time_ns == TIME_NS + hours * HOUR
        assert_equal_flows(loaded.at(TIME_NS + hours * HOUR), before)


def test_a_static_estimate_holds_at_any_time_also_after_it_was_saved(flow):
    static = replace(flow, later=constant)
    for known in (static, load_bytes(save_bytes(static), "flow")):
        later = known.at(TIME_NS + HOUR).at(TIME_NS - HOUR)
        assert_equal_flows(later, replace(flow, time_ns=TIME_NS - HOUR))


def loaded_as(flow, path, version, *without):
    """A flow saved in the form of an earlier version, which lacks some attributes, and read again."""
    flow.save(path)
    with h5netcdf.File(path, "a") as file:
        file.attrs["replay_kit_format_version"] = np.int32(version)
        for name in without:
            del file.attrs[name]
    with pytest.warns(UserWarning, match="has no checksum, as files of version 0.2.0"):
        return load(path)


def test_files_of_version_2_open_without_a_model_of_time(flow, tmp_path):
    loaded = loaded_as(flow, tmp_path / "flow.nc", 2, "evolution", "horizontal_functions")
    assert_equal_flows(loaded, flow)
    with pytest.raises(EstimatorError, match="has no model of time"):
        loaded.at(TIME_NS)


def test_files_of_version_3_open_with_the_kernel_of_the_grid_s_nodes(tmp_path):
    flow = evolving()
    loaded = loaded_as(flow, tmp_path / "flow.nc", 3, "horizontal_functions")
    assert_equal_flows(loaded, flow)
    assert_equal_flows(loaded.at(TIME_NS + HOUR), flow.at(TIME_NS + HOUR))


def test_currents_drawn_through_time_have_the_estimate_s_moments_and_the_process_s_correlation():
    flow, times = evolving(3, 1), [TIME_NS, TIME_NS + 3 * HOUR, TIME_NS + 9 * HOUR]
    evolution, count = flow.later, 4_000
    assert isinstance(evolution, Evolution)
    drawn = sample_through(flow, times, count, 5)
    assert (len(drawn), [one.time_ns for one in drawn[0]], drawn[0][0].later) == (
        count,
        times,
        None,
    )
    latent = np.array([[one.latent.ravel() for one in through] for through in drawn])
    expected = [flow.at(time_ns) for time_ns in times]
    loading = [
        np.einsum("mr,nzr->nmz", flow.modes, evolution.process.loading(time_ns)).reshape(4, -1)
        for time_ns in times
    ]
    decayed = [np.exp(-hours / np.array([50.0] * 3 + [10.0])) for hours in (0.0, 3.0, 9.0)]
    for k, one in enumerate(expected):
        scale = np.sqrt(np.diag(loading[k].T @ (covariance_of(evolution, decayed[k])) @ loading[k]))
        np.testing.assert_allclose(
            latent[:, k].mean(axis=0), one.latent.ravel(), atol=5.0 * scale.max() / np.sqrt(count)
        )
        # between the first time and a later one only the decay of the unknowns counts
        cross = loading[0].T @ (evolution.covariance() * decayed[k]) @ loading[k]
        found = (
            (latent[:, 0] - latent[:, 0].mean(axis=0)).T
            @ (latent[:, k] - latent[:, k].mean(axis=0))
            / count
        )
        np.testing.assert_allclose(
            found, cross, atol=0.1 * np.abs(cross).max() + 0.06 * scale.max() ** 2
        )
        own = np.var(latent[:, k], axis=0)
        np.testing.assert_allclose(own, scale**2, rtol=0.2, atol=5e-3 * scale.max() ** 2)
    same = sample_through(flow, times, 2, 5)
    np.testing.assert_array_equal(same[1][2].latent, sample_through(flow, times, 2, 5)[1][2].latent)


def covariance_of(evolution, kept):
    return np.outer(kept, kept) * evolution.covariance() + np.diag(1.0 - kept**2)


def test_currents_drawn_from_an_estimate_that_does_not_change_hold_at_all_times():
    flow = replace(synthetic_flow(), later=constant)
    for through, one in zip(
        sample_through(flow, [TIME_NS, TIME_NS + HOUR], 2, 3), flow.sample(2, 3), strict=True
    ):
        assert [each.time_ns for each in through] == [TIME_NS, TIME_NS + HOUR]
        np.testing.assert_array_equal([each.latent for each in through], [one.latent] * 2)
    with pytest.raises(EstimatorError, match="needs an estimate with a covariance"):
        sample_through(flow.mean_flow(), [TIME_NS], 2, 3)
