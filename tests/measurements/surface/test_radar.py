"""The field of what radars show beside an estimate: the fit finds what it was drawn from, and it errs by what it states."""

import numpy as np
import pytest

from replay_kit.core.geodesy import to_local
from replay_kit.core.grid import Projection
from replay_kit.core.observation import Label, Source
from replay_kit.measurements.surface.residual_field import ResidualField
from replay_kit.measurements.surface.vectors import superobservations

TRUE = ResidualField(0.07, 20e3, 0.3)
LABEL = Label(0, Source(0, "/radar", 0, 0), kind="radar")


@pytest.fixture(scope="module")
def drawn():
    """Vectors 6 km apart of four times, what they are beside an estimate."""
    rng = np.random.default_rng(3)
    longitude, latitude = (
        each.ravel()
        for each in np.meshgrid(-72.8 + 0.07 * np.arange(15), 39.9 + 0.054 * np.arange(15))
    )
    stated = rng.uniform(0.08, 0.12, longitude.size)
    still = np.zeros((stated.size, 2))
    radar = {"longitude": longitude, "latitude": latitude, "value": still, "error_std": stated}
    radar |= {"direction": None, "depth": 2.0, "averaged": 3600.0, "error_length": 1e3}
    seen = superobservations(radar, LABEL, 20e3, 0.0)[0].label.vectors
    np.testing.assert_allclose(np.sort(seen.error_std), np.sort(stated))
    longitude, latitude = seen.value_places
    x, y = to_local(Projection(-72.3, 40.3), longitude, latitude)
    apart = np.hypot(x[:, None] - x, y[:, None] - y)
    own = TRUE.error_factor * seen.error_std
    covariance = TRUE.std**2 * np.exp(-apart / TRUE.length)
    covariance += np.outer(own, own) * np.exp(-apart / 1e3)
    root = np.linalg.cholesky(covariance)
    return [(seen, root @ rng.standard_normal((x.size, 2))) for _ in range(4)]


def test_the_likeliest_field_is_near_that_of_the_draws(drawn):
    found = ResidualField.likeliest(drawn)
    # lengths and shares of errors are tried in steps of 1.4 and 2
    assert found.std == pytest.approx(TRUE.std, rel=0.25)
    assert 10e3 < found.length < 40e3
    assert 0.1 < found.error_factor < 0.6


def test_withheld_vectors_are_predicted_within_what_is_stated(drawn):
    off = []
    for seen, residual in drawn:
        hidden = np.arange(len(residual)) % 2 == 0
        places = (each[hidden] for each in seen.value_places)
        known = np.where(hidden[:, None], np.nan, residual)
        found, std = TRUE.between(seen, known, *places)
        error = np.hypot(std, TRUE.error_factor * seen.error_std[hidden])
        off.append((found - residual[hidden]) / error[:, None])
    assert 0.87 < np.mean(np.abs(np.concatenate(off)) < 1.645) < 0.96
