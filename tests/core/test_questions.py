"""What a script asks of an estimate, and the answers where there is none: depths, times, levels and members that it cannot answer for."""

import warnings

import numpy as np
import pandas as pd
import pytest

import replay_kit as rk
from replay_kit.core.errors import EstimatorError
from replay_kit.logs.mcap.writer import write_mcap_log
from tests import synthetic
from tests.command import invoke, succeed
from tests.places import SAMPLES

LOG, ENSEMBLE = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"
SETTINGS = {
    "logs": {"end": "2018-11-16T04:00:00Z"},
    "forecast": {"levels": [5, 150, 500]},
    "estimator": {"modes": 10, "sample_share": 0.5, "shift_distance": 0.0},
    "time": {"scale": "static"},
}
PLACE = 153.1, -40.25
AXES = {"longitude": [153.1], "latitude": [-40.25]}
LATER = "2018-12-01T00:00:00Z"


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return rk.replay(
        LOG, ENSEMBLE, out=tmp_path_factory.mktemp("q") / "first.mcap", settings=SETTINGS
    )


DOORS = {
    "velocity_at": lambda result, depth: result.estimate.velocity_at(*PLACE, depth),
    "to_xarray": lambda result, depth: result.estimate.to_xarray(**AXES, depth=[5.0, depth]),
    "along": lambda result, depth: result.estimate.along(
        {"longitude": [153.1] * 2, "latitude": -40.25, "depth": [5.0, depth]}
    ),
    "velocity": lambda result, depth: result.estimate.velocity(0.0, 0.0, depth),
    "standard_error": lambda result, depth: result.estimate.standard_error(0.0, 0.0, [depth, 9.0]),
    "covariance": lambda result, depth: result.estimate.velocity_covariance(0.0, 0.0, depth),
}


@pytest.mark.parametrize("door", DOORS.values(), ids=DOORS.keys())
@pytest.mark.parametrize("depth", [-1.5, np.nan, np.inf])
def test_depths_are_finite_and_positive_down_at_every_door(result, door, depth):
    with pytest.raises(EstimatorError, match=rf"positive down, expected .*, got {depth:g} "):
        door(result, depth)


def test_a_rounded_depth_and_a_vehicle_at_the_surface_are_at_the_surface(result):
    surface = result.estimate.velocity_at(*PLACE, 0.0)
    assert result.estimate.velocity_at(*PLACE, -1e-9).u == surface.u
    found = result.estimate.along({"longitude": PLACE[0], "latitude": PLACE[1], "depth": -0.4})
    assert (found.u, found.depth) == (surface.u, -0.4)


def test_the_table_of_the_track_has_no_current_where_the_depth_is_not_known(tmp_path):
    messages = [
        one._replace(payload=one.payload | {"metadata": []}) if one.topic == "/vehicle/fix" else one
        for one in rk.open_log(LOG)
        if one.topic != "/dac"
    ]
    write_mcap_log(tmp_path / "log.mcap", messages)
    made = rk.replay(tmp_path / "log.mcap", ENSEMBLE, settings=SETTINGS)
    succeed(f"export {made.path} --table track -o {tmp_path}/track.csv")
    found, known = pd.read_csv(tmp_path / "track.csv"), made.fixes["depth"].notna()
    assert 0 < known.sum() < known.size
    np.testing.assert_array_equal(found["depth"], made.fixes["depth"])
    for name in ("u", "v", "u_standard_error", "v_standard_error"):
        np.testing.assert_array_equal(found[name].notna(), known)
    with pytest.raises(EstimatorError, match=r"got nan .* leave out points of unknown depth"):
        made.estimate.along(made.fixes)
    along = made.estimate.along(made.fixes[known])
    np.testing.assert_allclose(along.u, found["u"].dropna(), rtol=1e-12)


def test_a_constant_estimate_knows_the_span_of_its_data(result, tmp_path):
    estimate, fixes = result.estimate, result.fixes
    first, last = np.array(estimate.span_ns, "M8[ns]")
    assert first <= fixes.index[0] < fixes.index[-1] <= last
    text = "2018-11-16 00:00:00Z to 2018-11-16 04:00:00Z"
    assert f"(constant in time, data {text})" in repr(estimate)
    estimate.save(tmp_path / "flow.nc")
    saved = rk.open_estimate(tmp_path / "flow.nc").span_ns
    assert saved == rk.open_result(result.path).estimate.span_ns == estimate.span_ns
    # inside it nothing is said, but of which time the answer is
    assert "11-16 01:00:00Z (estimate for 2018-11-16 04:00:00Z)" in repr(
        estimate.velocity_at(*PLACE, 150.0, "2018-11-16T01:00:00Z")
    )
    assert {*estimate.along(fixes).estimate_time.tolist()} == {estimate.time_ns}


TIMED = {
    "velocity_at": lambda result: result.estimate.velocity_at(*PLACE, 150.0, LATER),
    "result": lambda result: result.velocity_at(*PLACE, 150.0, LATER),
    "along": lambda result: result.estimate.along(
        {"longitude": 153.1, "latitude": -40.25, "depth": 150.0, "time": LATER}
    ),
    "at": lambda result: result.estimate.at(1_543_622_400 * 10**9).velocity_at(*PLACE, 150.0),
    "to_xarray": lambda result: result.estimate.to_xarray(**AXES, depth=[150.0], time=[LATER]),
}


@pytest.mark.parametrize("door", TIMED.values(), ids=TIMED.keys())
def test_a_time_outside_the_data_of_a_constant_estimate_is_answered_with_a_warning(result, door):
    now = result.estimate.velocity_at(*PLACE, 150.0)
    words = "12-01 00:00:00Z is outside .* data, 2018-11-16 00:00:00Z to 2018-11-16 04.*constant in time"
    with pytest.warns(UserWarning, match=words) as said:
        found = door(result)
    assert [each.filename for each in said] == [__file__]
    np.testing.assert_allclose(np.ravel(found.u_standard_error), now.u_standard_error, rtol=1e-6)
    np.testing.assert_array_equal(found.estimate_time, now.time)


def test_who_plans_is_not_warned(result):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        rk.plan(result.estimate, (153.12, -40.28, 0.0), (153.05, -40.2, 150.0), time=LATER)


def test_a_result_is_asked_as_an_estimate_is(result):
    asked = *PLACE, [5.0, 150.0], "2018-11-16T02:00:00Z"
    found, expected = (one.velocity_at(*asked).to_pandas() for one in (result, result.estimate))
    pd.testing.assert_frame_equal(found, expected)


def test_levels_that_the_paper_s_functions_cannot_tell_apart_are_refused(tmp_path):
    levels = 10.0 * np.arange(12)
    sea = synthetic.dataset(levels=levels, west=152.9, south=-40.5)
    sea.to_netcdf(tmp_path / "close.nc", engine="h5netcdf")
    given = f"{LOG} --ensemble {tmp_path}/close.nc -o {tmp_path}/x.mcap"
    done = invoke(f"replay {given} --preset paper")
    assert isinstance(done.exception, EstimatorError)
    assert "levels 0, 10, 20" in done.stderr
    assert "estimator.length_vertical" in done.stderr
    assert not (tmp_path / "x.mcap").exists()


@pytest.mark.parametrize(
    ("members", "stated", "said"),
    [(3, "", True), (4, "", False), (2, "representation_error_std = 0.1", False)],
)
def test_too_few_members_to_state_errors_are_said_before_the_replay(
    members, stated, said, tmp_path, caplog
):
    data = synthetic.dataset(n_members=members, west=152.9, south=-40.5)
    data.to_netcdf(tmp_path / "few.nc", engine="h5netcdf")
    (tmp_path / "run.toml").write_text(f"[estimator]\n{stated}")
    files = f"{LOG} --ensemble {tmp_path}/few.nc --config {tmp_path}/run.toml"
    succeed(f"replay {files} -o {tmp_path}/x.mcap --dry-run")
    assert (f"{members} members are too few to state errors" in caplog.text) == said
