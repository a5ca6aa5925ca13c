"""A forecast at all of its dated times."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.forecast import read_series
from replay_kit.forecast.members.rules import Elsewhere
from replay_kit.workflows.replay.inputs.forecast import read_forecasts
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import noted, read_with, saved
from tests.forecast.test_members import lagged

DAY = 86_400 * 10**9


def with_leads(
    path, leads=(0.0, 2.0, 5.0), reference="2020-01-01T00:00:00", units="days", holes=False
):
    """The synthetic ensemble, stronger at each lead."""
    parts = [synthetic.dataset() * (1.0 + 0.5 * k) for k in range(len(leads))]
    ds = forms.in_turn(parts, np.array(leads), "lead", units=units, standard_name="forecast_period")
    if reference:
        ds["forecast_reference_time"] = np.datetime64(reference, "ns")
    if holes:
        ds["uo"][1, :, :, 0, 0] = np.nan
        ds["vo"][1, :, :, 0, 0] = np.nan
    ds.to_netcdf(path, engine="scipy")
    return path


@pytest.fixture(scope="module")
def of_reference(tmp_path_factory):
    """Return the file of leads from a reference time, the same for all tests."""

    @cache
    def file(reference):
        return with_leads(tmp_path_factory.mktemp("leads") / "e.nc", reference=reference)

    return file


@pytest.fixture(scope="module")
def lags(tmp_path_factory):
    return saved(lagged(), tmp_path_factory.mktemp("lags"))


def test_each_lead_is_the_ensemble_that_would_be_read_alone(of_reference):
    path = of_reference("2020-01-01")
    series = read_series(path, ForecastConfig())
    assert [part.time_ns - series[0].time_ns for part in series] == [0, 2 * DAY, 5 * DAY]
    for part, lead in zip(series, (0.0, 2.0, 5.0), strict=True):
        assert_array_equal(part.velocity, read_with(path, lead=lead).velocity)
    assert noted(series[0], "3 times")
    assert not noted(series[0], "the spread of members")


@pytest.mark.parametrize("config", [ForecastConfig(lead=2.0), ForecastConfig()])
def test_a_chosen_lead_or_leads_without_a_date_leave_one(tmp_path, config):
    path = with_leads(tmp_path / "e.nc", reference="2020-01-01T00:00:00" if config.lead else "")
    assert len(read_series(path, config)) == 1


STATIC = {"time": {"scale": "static"}}
PAPER = {"estimator": {"preset": "paper"}}
NEAREST = {"estimator": {"name": "nearest"}}


@pytest.mark.parametrize(
    ("settings", "reference", "log_starts", "leads"),
    [
        ({}, "2020-01-01", 2.2, [0.0, 2.0, 5.0]),
        ({}, "2020-01-01", None, [0.0, 2.0, 5.0]),
        ({"forecast": {"lead": 1.9}}, "2020-01-01", 4.9, [2.0]),
        *((kept, "2020-01-01", 2.2, [2.0]) for kept in (STATIC, PAPER, NEAREST)),
        *((kept, "2020-01-01", -3.0, [0.0]) for kept in (STATIC, PAPER, NEAREST)),
        *((kept, "2020-01-01", None, [5.0]) for kept in (STATIC, PAPER, NEAREST)),
        *((kept, "", 2.2, [5.0]) for kept in ({}, STATIC, PAPER, NEAREST)),
        ({"forecast": {"reference_time": "2020-01-01"}, **STATIC}, "", 2.2, [2.0]),
    ],
)
def test_which_leads_a_run_uses_when_none_is_chosen(
    of_reference, settings, reference, log_starts, leads
):
    path = of_reference(reference)
    near_ns = (
        None
        if log_starts is None
        else int(np.datetime64("2020-01-01", "ns").astype(np.int64) + log_starts * DAY)
    )
    found = read_forecasts(path, load_config(None, settings), near_ns, None)
    # each lead's current is stronger than the one before by half of the first
    strengths = [
        np.abs(part.velocity).max() / np.abs(synthetic.ensemble().velocity).max()
        for part in found.series
    ]
    assert_allclose(
        strengths, [1.0 + 0.5 * [0.0, 2.0, 5.0].index(lead) for lead in leads], rtol=1e-6
    )


def test_a_log_far_from_the_forecast_is_said(of_reference):
    path = of_reference("2020-01-01")
    start = read_series(path, ForecastConfig())[0].time_ns
    for days, words in ((1, None), (6, None), (8, "3.0 days outside"), (-2, "2.0 days outside")):
        first = read_series(path, ForecastConfig(), near_ns=start + days * DAY)[0]
        assert noted(first, words or "outside") == bool(words)
        assert any(isinstance(note, Elsewhere) for note in first.notes) == bool(words)


def test_the_same_time_twice_and_land_that_changes_are_refused(tmp_path):
    with pytest.raises(ForecastError, match="are the same"):
        read_series(with_leads(tmp_path / "a.nc", leads=(0.0, 2.0, 2.0)), ForecastConfig())
    with pytest.raises(ForecastError, match="land is not the same"):
        read_series(with_leads(tmp_path / "b.nc", holes=True), ForecastConfig())


THROUGH_TIME = {"time": {"scale": 86400.0}}


@pytest.mark.parametrize(
    ("settings", "spread", "who"),
    [
        (THROUGH_TIME, None, "an estimate through time"),
        (PAPER, None, "the preset paper"),
        (NEAREST, None, "the estimator nearest"),
        *((settings, "as_given", "") for settings in (THROUGH_TIME, PAPER, NEAREST)),
        *((settings, 2.0, "") for settings in (THROUGH_TIME, PAPER)),
        *((settings, spread, "") for settings in ({}, STATIC) for spread in (None, "fit", 2.0)),
    ],
)
def test_a_spread_that_is_not_fitted_is_said(lags, settings, spread, who):
    tables = {**settings, "forecast": {"members": "lags"}}
    tables["estimator"] = {
        **settings.get("estimator", {}),
        **({} if spread is None else {"spread": spread}),
    }
    found = read_forecasts(lags, load_config(None, tables), None, None)
    notes = [note for note in found.notes if "the spread of members" in note]
    assert notes == (
        [f"the spread of members made of lags is used as their error: {who} does not fit it"]
        if who
        else []
    )
    assert found.ensemble.notes == found.notes


@pytest.mark.parametrize(
    ("settings", "spread", "message"),
    [
        (
            {},
            "fit",
            'expected as_given or a number with an estimate through time, got fit; leave it out, or set time.scale = "static"',
        ),
        (
            PAPER,
            "fit",
            "expected as_given or a number with the preset paper, got fit; leave it out$",
        ),
        (NEAREST, "fit", "expected as_given with the estimator nearest, got fit; leave it out$"),
        (NEAREST, 2.0, r"expected as_given with the estimator nearest, got 2\.0; leave it out$"),
    ],
)
def test_a_spread_that_an_estimator_does_not_take_is_refused(
    of_reference, settings, spread, message
):
    tables = {"estimator": {**settings.get("estimator", {}), "spread": spread}}
    with pytest.raises(ConfigError, match=rf"^estimator\.spread: {message}"):
        read_forecasts(of_reference("2020-01-01"), load_config(None, tables), None, None)
