"""Innovations in columns: as they were written, in blocks of any size; of a long log summed over all and kept within bounds."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from replay_kit.core.as_flown import FlightCorrection
from replay_kit.core.observation import Innovation, Source
from replay_kit.results import ResultWriter
from replay_kit.results.innovations import (
    BINS,
    block_of,
    columns_of,
    joined_blocks,
    measured_of,
    picked_rows,
    tables_of,
)
from replay_kit.results.outcome.parts import correction_part
from replay_kit.results.result import ResultFile
from tests.results.cases import one_bin
from tests.results.result_samples import CONFIG, METADATA, decoded
from tests.synthetic_flow import TIME_NS

SECOND = 10**9
PAIRS = ("innovation", "innovation_std", "residual", "prior_innovation")
OPTIONAL = ("measured", "replayed_residual")
SINGLE = ("nis", "error_inflation", "gate_statistic", "signal_dof", "mean_std", "estimated_std")

numbers = st.floats(width=64, allow_subnormal=False)
halves = st.floats(width=32)


@st.composite
def drawn(draw):
    """Return an innovation of any values; those of bins are such that float32 holds."""
    n = draw(st.integers(0, 3))
    pairs = arrays(np.float64, (n, 2), elements=halves)
    maybe = st.none() | pairs
    currents = st.none() | arrays(np.float64, 2, elements=numbers)
    whole = st.integers(0, 2**32 - 1)
    source = Source(
        draw(whole),
        draw(st.text(max_size=3)),
        draw(st.integers(0, 2**64 - 1)),
        draw(st.integers(-(2**63), 2**63 - 1)),
    )
    return Innovation(
        time_ns=draw(st.integers(0, 2**63 - 1)),
        depth=draw(arrays(np.float64, n, elements=halves)),
        dof=draw(whole),
        accepted=draw(st.booleans()),
        flags=draw(arrays(np.int8, n)),
        reasons=draw(arrays(np.int32, n, elements=st.integers(0, 2**25))),
        dive=draw(whole),
        source=source,
        decision=draw(st.sampled_from(["accepted", "rejected", "unusable"])),
        gate=draw(numbers),
        mean_kind=draw(st.sampled_from(["", "dac", "radar"])),
        mean_current=draw(currents),
        corrected_current=draw(currents),
        corrected_std=draw(numbers),
        profiles=draw(whole),
        **{name: draw(pairs) for name in PAIRS},
        **{name: draw(maybe) for name in OPTIONAL},
        **{name: draw(numbers) for name in SINGLE},
    )


@settings(max_examples=12)
@given(st.lists(drawn(), min_size=1, max_size=5), st.integers(1, 5))
def test_a_block_holds_what_was_written_however_it_is_cut(given_ones, size):
    whole = columns_of(block_of(given_ones))
    cut = range(0, len(given_ones), size)
    parts = joined_blocks([columns_of(block_of(given_ones[at : at + size])) for at in cut])
    assert whole.keys() == parts.keys()
    for name, values in whole.items():
        np.testing.assert_array_equal(parts[name], values)
    for k, one in enumerate(given_ones):
        row = picked_rows(whole, np.arange(len(given_ones)) == k)
        row = {name: each if name in BINS else each[0] for name, each in row.items()}
        for name in (*PAIRS, *OPTIONAL):
            pair = getattr(one, name)
            expected = np.full((one.depth.size, 2), np.nan) if pair is None else pair
            np.testing.assert_array_equal(
                np.column_stack([row[f"{name}_east"], row[f"{name}_north"]]), expected
            )
        for name in ("depth", "flags", "reasons"):
            np.testing.assert_array_equal(row[name], getattr(one, name))
        source = (row["source_input"], row["source_topic"], row["source_position"])
        assert Source(*source, row["source_time"]) == one.source
        for name, value in (("measured", one.mean_current), ("corrected", one.corrected_current)):
            held = [row[f"mean_current_{name}_{end}"] for end in ("east", "north")]
            np.testing.assert_array_equal(held, np.full(2, np.nan) if value is None else value)
        names = {name: name for name in (*SINGLE[:4], "dof", "accepted", "decision", "profiles")}
        names |= {
            "timestamp": "time_ns",
            "gate_threshold": "gate",
            "mean_current_kind": "mean_kind",
        }
        for kind, held in {
            "measured": "mean",
            "corrected": "corrected",
            "estimated": "estimated",
        }.items():
            names[f"mean_current_{kind}_standard_error"] = f"{held}_std"
        for name, attribute in names.items():
            np.testing.assert_equal(row[name], getattr(one, attribute))


def test_other_readers_find_lists_of_numbers(innovation, tmp_path):
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.innovations([innovation, replace(innovation, time_ns=TIME_NS + SECOND)])
    ((log_time, value),) = decoded(tmp_path / "out.mcap")["/flow/innovation"]
    assert log_time == value.timestamp[1] == TIME_NS + SECOND
    assert (list(value.depth), list(value.bins)) == ([10.0, 20.0, 30.0, 40.0] * 2, [4, 4])
    np.testing.assert_array_equal(value.residual_east[:4], innovation.residual[:, 0])
    assert (list(value.flags[:4]), list(value.accepted)) == ([1, 1, 9, 1], [True, True])
    # of which nothing is known
    assert len(value.replayed_residual_east) == len(value.mean_current_measured_east) == 0


def test_a_mean_current_is_predicted_and_estimated_by_what_was_used(innovation):
    measured, corrected = np.array([0.1, -0.2]), np.array([0.05, -0.15])
    one = one_bin(innovation, mean_current=measured, mean_kind="dac", mean_std=0.01)
    about = {"corrected_current": corrected, "corrected_std": 0.02, "estimated_std": 0.03}
    table, _ = tables_of(
        columns_of(block_of([innovation, replace(one, **about), replace(one, mean_kind="drift")]))
    )
    assert table["mean_current_kind"].isna().tolist() == [True, False, False]
    for name, used in (("predicted", "innovation"), ("estimated", "residual")):
        found = table[[f"mean_current_{name}_{end}" for end in ("east", "north")]].to_numpy()
        off = getattr(innovation, used)[0]
        np.testing.assert_allclose(found[1:], [corrected - off, measured - off], rtol=1e-12)
    errors = table.filter(regex="mean_current.*standard_error").iloc[1]
    assert errors.tolist() == [0.01, 0.02, 0.03]


@pytest.fixture
def result(tmp_path, flow, innovation):
    """Return a result of two instruments that take turns, each ten pings a mean current, the last a drift, in blocks of 7."""
    block = []
    with ResultWriter(tmp_path / "out.mcap") as writer:
        writer.start(flow.grid.projection, TIME_NS, METADATA, CONFIG)
        for k in range(60):
            source = replace(innovation.source, topic=f"/adcp_{k % 2}")
            decision = "rejected" if k % 9 == 0 else "accepted"
            about = {"dive": 1 + k // 10, "accepted": k % 9 > 0, "decision": decision}
            one = replace(innovation, nis=float(k), source=source, **about)
            block.append(replace(one, time_ns=TIME_NS + k * SECOND))
            if k % 10 == 9:
                mean = {
                    "mean_current": np.array([0.1, 0.2]),
                    "mean_kind": "drift" if k > 50 else "dac",
                }
                block.append(one_bin(one, time_ns=TIME_NS + k * SECOND + 1, **mean))
        for begin in range(0, len(block), 7):
            writer.innovations(block[begin : begin + 7])
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


def test_the_correction_is_stated_with_its_size_and_the_dives_it_is_from():
    found = FlightCorrection((0.03, 0.04), 0.6, -0.01, 0.07, 0.06, 5, 8.44)
    figures = correction_part(found)
    assert (figures["corrected"], figures["largest_m_s"], figures["dives"]) == (2, 0.04, 5)
    assert figures["rms_m_s"] == pytest.approx(0.05 / np.sqrt(2.0))
