"""Measurements of a long log are summed over all and kept within bounds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from replay_kit.results import ResultWriter, measurements
from replay_kit.results.measurements import measured_of
from replay_kit.results.result import ResultFile
from tests.results.cases import one_bin
from tests.results.result_samples import CONFIG, METADATA
from tests.synthetic_flow import TIME_NS

SECOND = 10**9


@pytest.fixture
def result(tmp_path, flow, innovation, monkeypatch):
    """Return a result of two instruments that take turns, with a mean current after each dive of ten pings, read in blocks of 7."""
    monkeypatch.setattr(measurements, "_BLOCK", 7)
    mean = {"mean_current": np.array([0.1, 0.2]), "mean_kind": "dac"}
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        for k in range(60):
            source = replace(innovation.source, topic=f"/adcp_{k % 2}")
            decision = "rejected" if k % 9 == 0 else "accepted"
            about = {"dive": 1 + k // 10, "accepted": k % 9 > 0, "decision": decision}
            one = replace(innovation, nis=float(k), source=source, **about)
            writer.innovation(replace(one, time_ns=TIME_NS + k * SECOND))
            if k % 10 == 9:
                writer.innovation(one_bin(one, time_ns=TIME_NS + k * SECOND + 1, **mean))
        writer.finish(flow)
    return ResultFile(tmp_path / "out.mcap")


def test_of_a_short_log_all_are_kept(result):
    measured = result.measured
    pd.testing.assert_frame_equal(measured.observations, result.observations)
    pd.testing.assert_frame_equal(measured.innovations, result.innovations)
    assert (measured.count, measured.profiles) == (66, 60)


def test_of_a_long_log_each_topic_is_thinned_alike_and_no_mean_current_left_out(result):
    measured = measured_of(result.blocks(), most=20)
    rows, bins, whole = measured.observations, measured.innovations, result.observations
    profiles = rows["mean_current_kind"].isna()
    assert (~profiles).sum() == 6
    numbers = [row.nis for row in rows[profiles].itertuples()]
    assert numbers == [k for k in range(60) if k % 8 < 2]
    assert rows[profiles]["source_topic"].value_counts().to_dict() == {"/adcp_0": 8, "/adcp_1": 8}
    # the bins are those of the rows
    assert (
        bins["observation"].tolist()
        == np.repeat(np.arange(len(rows)), np.where(profiles, 4, 1)).tolist()
    )
    assert (rows.index[bins["observation"]] == bins.index).all()
    fewer = measured_of(result.blocks(), most_bins=100)
    assert len(fewer.innovations) <= 100
    # sums are over all
    for one in (measured, fewer):
        pd.testing.assert_frame_equal(one.sums, result.measured.sums)
        assert (one.count, one.profiles) == (66, 60)
    used = whole[whole["accepted"]]
    sums = measured.sums[measured.sums["accepted"]]
    assert sums["measurements"].sum() == len(used)
    for name in ("nis", "dof", "signal_dof"):
        np.testing.assert_allclose(sums[name].sum(), used[name].sum(), rtol=1e-12)
    squares = (used["rms_residual"] ** 2 * used["dof"]).sum()
    np.testing.assert_allclose(sums["square_residual"].sum(), squares, rtol=1e-12)
    assert sums["last"].max() == used.index.max()


def test_bins_that_were_not_used_are_counted_by_reason(result):
    assert measured_of(result.blocks(), most=20).bins_rejected == {"missing": 60}
