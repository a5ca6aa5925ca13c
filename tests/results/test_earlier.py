"""Results of earlier versions, written by these, open as those of this version do.

``files/contract5.mcap`` and ``contract4.mcap`` (of 0.3, without an estimate) hold a profile, a rejected one and a mean current of a dive,
each followed by weights, in a run that corrected mean currents.
"""

from pathlib import Path

import numpy as np
import pytest

from replay_kit import open_result
from replay_kit.results.views.along_track import mean_currents
from replay_kit.results.views.contents import Contents
from replay_kit.show.status.held import read_held
from replay_kit.show.status.status import status_of
from tests.synthetic_flow import TIME_NS

FILES = Path(__file__).parent / "files"
SECOND = 10**9


@pytest.fixture(params=[4, 5])
def contract(request):
    return request.param


@pytest.fixture
def result(contract):
    return open_result(FILES / f"contract{contract}.mcap")


def pair(table, name):
    return table[[f"{name}_east", f"{name}_north"]].to_numpy()


def test_innovations(result, innovation):
    table, bins = result.observations, result.innovations
    assert table["decision"].tolist() == ["accepted", "rejected", "accepted"]
    assert (table["nis"].tolist(), table["dof"].tolist()) == ([5.5, 6.5, 5.5], [6, 6, 2])
    assert table["source_topic"].tolist() == ["/adcp", "/adcp", "/dac"]
    assert table["gate_threshold"].tolist() == [20.5] * 3
    assert bins["observation"].tolist() == [0] * 4 + [1] * 4 + [2]
    for name in ("innovation", "innovation_std", "residual", "prior_innovation"):
        each = getattr(innovation, name)
        np.testing.assert_allclose(pair(bins, name), [*each, *each, each[0]], rtol=1e-6)
    assert bins["replayed_residual_east"].isna().all()
    assert bins["flags"].tolist() == [1, 1, 9, 1] * 2 + [1]


def test_a_mean_current_has_the_name_of_what_it_is(result, contract, innovation):
    table, held = result.observations, ([0.1, -0.2], [0.05, -0.15])
    # before contract version 5 a corrected one was called measured
    measured, corrected = held if contract == 5 else ([np.nan] * 2, held[0])
    for name, expected in (("measured", measured), ("corrected", corrected)):
        np.testing.assert_array_equal(pair(table, f"mean_current_{name}")[2], expected)
    means = mean_currents(result.measured)
    np.testing.assert_allclose(means.estimated, corrected - innovation.residual[:1], rtol=1e-6)
    errors = [0.01, 0.02, 0.03] if contract == 5 else [np.nan] * 3
    np.testing.assert_array_equal(means.errors, [errors])
    found = status_of(read_held(result.reader)).figures["current"]
    assert found["dive"] == 2
    assert ("measured" in found) == (contract == 5)
    off = np.hypot(*innovation.innovation[0])
    assert found["difference_m_s"] == pytest.approx(off, rel=1e-6)


def test_the_estimate_and_its_weights(flow):
    contents = Contents(open_result(FILES / "contract5.mcap"))
    estimate, weights = contents.estimate, np.linspace(-1.0, 1.0, 12)
    assert estimate is not None
    np.testing.assert_array_equal(estimate.latent, flow.latent)
    flows = list(contents.history.after(TIME_NS + SECOND * np.array([-1, 0, 2, 9])))
    assert flows[0] is None
    for factor, one in zip((1.0, 2.0, 3.0), flows[1:], strict=True):
        by_level = factor * weights.reshape(3, 4).T
        expected = flow.unknowns.offset + flow.modes @ by_level
        np.testing.assert_allclose(one.latent, expected, rtol=1e-12)
    # what was measured is not stated: it is the estimate then and the residual
    bins = contents.bins
    np.testing.assert_allclose(
        bins.estimated[:3],
        flows[1].velocity(*contents.track.at(bins.time_ns[:3])[:2], bins.depth[:3]),
    )
