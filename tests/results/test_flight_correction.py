"""Mean currents of dives in results: measured, corrected and estimated, in results of this version and of version 0.2.0."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit import open_result
from replay_kit.core.as_flown import FlightCorrection
from replay_kit.results import ResultWriter
from replay_kit.results.outcome.from_run import flight_correction_json
from replay_kit.results.views.along_track import mean_currents
from tests.results.cases import one_bin
from tests.results.result_samples import METADATA
from tests.synthetic_flow import TIME_NS

WITH, WITHOUT = (f"[measurements]\nflight_bias = {value}\n" for value in ("true", "false"))
MEASURED, CORRECTED = np.array([0.1, -0.2]), np.array([0.05, -0.15])
OLD = {"contract": {"version": "4"}}


def written(path, flow, state, innovation, config, **current):
    """A result with the mean currents of a dive and of a drift."""
    one = one_bin(innovation, mean_current=MEASURED, dive=1)
    with ResultWriter(path) as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, config)
        writer.fix(state)
        for number, kind in enumerate(("dac", "drift")):
            source = replace(one.source, topic=f"/{kind}")
            more = current if kind == "dac" else {}
            writer.innovation(
                replace(one, time_ns=TIME_NS + number, mean_kind=kind, source=source, **more)
            )
    return open_result(path)


def pairs(result, kind):
    return result.observations[
        [f"mean_current_{kind}_east", f"mean_current_{kind}_north"]
    ].to_numpy()


def test_each_of_the_three_has_its_name_and_its_error(flow, state, innovation, tmp_path):
    stated = {
        "mean_std": 0.01,
        "corrected_current": CORRECTED,
        "corrected_std": 0.02,
        "estimated_std": 0.03,
    }
    result = written(tmp_path / "out.mcap", flow, state, innovation, WITH, **stated)
    np.testing.assert_array_equal(pairs(result, "measured"), [MEASURED, MEASURED])
    np.testing.assert_array_equal(pairs(result, "corrected"), [CORRECTED, [np.nan, np.nan]])
    np.testing.assert_allclose(
        pairs(result, "predicted")[0], CORRECTED - innovation.innovation[0], rtol=1e-12
    )
    np.testing.assert_allclose(
        pairs(result, "estimated")[0], CORRECTED - innovation.residual[0], rtol=1e-12
    )
    errors = result.observations.filter(regex="mean_current.*standard_error").iloc[0]
    assert errors.tolist() == [0.01, 0.02, 0.03]
    means = mean_currents(result.measured)
    np.testing.assert_array_equal(means.measured, [MEASURED])
    np.testing.assert_array_equal(means.corrected, [CORRECTED])
    np.testing.assert_allclose(means.estimated, CORRECTED - innovation.residual[:1], rtol=1e-12)
    np.testing.assert_array_equal(means.errors, [[0.01, 0.02, 0.03]])


@pytest.mark.parametrize(("config", "name"), [(WITH, "corrected"), (WITHOUT, "measured")])
def test_a_result_of_version_0_2_0_opens_and_calls_what_it_holds_by_its_name(
    flow, state, innovation, tmp_path, monkeypatch, config, name
):
    monkeypatch.setattr("replay_kit.results.mcap_writer.CONTRACT_VERSION", 4)
    result = written(tmp_path / "out.mcap", flow, state, innovation, config)
    other = "measured" if name == "corrected" else "corrected"
    np.testing.assert_array_equal(pairs(result, name)[0], MEASURED)
    assert np.isnan(pairs(result, other)[0]).all()
    # a drift has no flight model
    np.testing.assert_array_equal(pairs(result, "measured")[1], MEASURED)
    assert result.observations.filter(regex="standard_error|estimated").isna().all(axis=None)
    means = mean_currents(result.measured)
    np.testing.assert_array_equal(getattr(means, name), [MEASURED])
    np.testing.assert_allclose(means.estimated, MEASURED - innovation.residual[:1], rtol=1e-12)


def test_the_correction_is_stated_with_its_size_and_the_dives_it_is_from():
    found = FlightCorrection((0.03, 0.04), 0.6, -0.01, 0.07, 0.06, 5, 8.44)
    figures = flight_correction_json(found)
    assert (figures["corrected"], figures["largest_m_s"], figures["dives"]) == (2, 0.04, 5)
    assert figures["rms_m_s"] == pytest.approx(0.05 / np.sqrt(2.0))
