"""A forecast at all of its dated times."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import Caveat, ConfigError, ForecastError
from replay_kit.forecast import read_series
from replay_kit.workflows.replay.inputs.forecast import read_forecasts
from tests import synthetic
from tests.forecast import forms
from tests.forecast.forms import noted, saved
from tests.forecast.test_members import lagged

DAY, START = 86_400 * 10**9, int(np.datetime64("2020-01-01", "ns").astype(np.int64))


def with_leads(path, leads=(0.0, 2.0, 5.0), reference="2020-01-01", holes=False):
    """The synthetic ensemble, stronger at each lead."""
    parts = [synthetic.dataset() * (1.0 + 0.5 * k) for k in range(len(leads))]
    about = {"units": "days", "standard_name": "forecast_period"}
    ds = forms.in_turn(parts, np.array(leads), "lead", **about)
    if reference:
        ds["forecast_reference_time"] = np.datetime64(reference, "ns")
    for name in ("uo", "vo") if holes else ():
        ds[name][1, :, :, 0, 0] = np.nan
    return forms.save(ds, path)


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
    near_ns = None if log_starts is None else int(START + log_starts * DAY)
    config = load_config(None, settings)
    dated = reference or "reference_time" in settings.get("forecast", {})
    found = read_forecasts(of_reference(reference), config, near_ns, None).series
    # each lead's current is stronger than the one before by half of the first
    for part, lead in zip(found, leads, strict=True):
        factor = 1.0 + 0.5 * [0.0, 2.0, 5.0].index(lead)
        assert_allclose(part.velocity, factor * synthetic.ensemble().velocity, atol=1e-6)
        assert part.time_ns == (START + lead * DAY if dated else None)


@pytest.mark.parametrize(("days", "words"), [(1, ""), (6, ""), (8, "3.0 days"), (-2, "2.0 days")])
def test_a_log_far_from_the_forecast_is_said(of_reference, days, words):
    path, near_ns = of_reference("2020-01-01"), START + days * DAY
    first = read_series(path, ForecastConfig(), near_ns=near_ns)[0]
    assert noted(first, f"{words} outside" if words else "outside") == bool(words)
    assert any(isinstance(note, Caveat) for note in first.notes) == bool(words)


def test_the_same_time_twice_and_land_that_changes_are_refused(tmp_path):
    with pytest.raises(ForecastError, match="are the same"):
        read_series(with_leads(tmp_path / "a.nc", leads=(0.0, 2.0, 2.0)), ForecastConfig())
    with pytest.raises(ForecastError, match="land is not the same"):
        read_series(with_leads(tmp_path / "b.nc", holes=True), ForecastConfig())


THROUGH_TIME = {"time": {"biases": ["heading"]}}


def spread_of(settings, spread, members=None):
    """Settings with a spread, and perhaps members."""
    own = {} if spread is None else {"spread": spread}
    estimator = {**settings.get("estimator", {}), **own}
    return load_config(None, {**settings, "estimator": estimator, "forecast": members or {}})


@pytest.mark.parametrize(
    ("settings", "spread", "who"),
    [
        (THROUGH_TIME, None, "an estimate through time"),
        (PAPER, None, "the preset paper"),
        (NEAREST, None, "the estimator nearest"),
        *((settings, "as_given", "") for settings in (THROUGH_TIME, PAPER, NEAREST)),
        *((settings, 2.0, "") for settings in (THROUGH_TIME, PAPER)),
        *(({}, spread, "") for spread in (None, "fit", 2.0)),
        (STATIC, None, ""),
    ],
)
def test_a_spread_that_is_not_fitted_is_said(lags, settings, spread, who):
    found = read_forecasts(lags, spread_of(settings, spread, {"members": "lags"}), None, None)
    notes = [note for note in found.notes if "the spread of members" in note]
    assert len(notes) == bool(who)
    assert all(note.endswith(f"as their error: {who} does not fit it") for note in notes)
    assert found.ensemble.notes == found.notes


@pytest.mark.parametrize(
    ("settings", "spread", "message"),
    [
        ({}, "fit", r"as_given or a number with an estimate through time.*set time.scale"),
        (PAPER, "fit", "as_given or a number with the preset paper, got fit; leave it out$"),
        (NEAREST, "fit", "as_given with the estimator nearest, got fit; leave it out$"),
        (NEAREST, 2.0, r"as_given with the estimator nearest, got 2\.0; leave it out$"),
    ],
)
def test_a_spread_that_an_estimator_does_not_take_is_refused(
    of_reference, settings, spread, message
):
    with pytest.raises(ConfigError, match=rf"^estimator\.spread: expected {message}"):
        read_forecasts(of_reference("2020-01-01"), spread_of(settings, spread), None, None)
