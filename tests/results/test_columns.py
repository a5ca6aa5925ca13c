"""Messages as columns: lists one behind the other, with NaN for those that a message lacks."""

import numpy as np

from replay_kit.results.columns import ListValues, SingleValues, single_columns
from replay_kit.results.schemas import decode, encode


def innovation(**values):
    return decode("Innovation", encode("Innovation", values))


def test_lists_of_some_messages_alone_are_filled_with_nan_before_between_and_behind():
    found = ListValues("Innovation", "depth")
    residuals = ([], [1.0, 2.0], [], [3.0], [])
    for depth, residual in zip(
        ([10.0], [20.0, 21.0], [30.0, 31.0], [40.0], [50.0]), residuals, strict=True
    ):
        flags = [1] * len(depth)
        found.add(innovation(depth=depth, residual_east=residual, flags=flags, reasons=flags))
    counts, columns = found.columns()
    np.testing.assert_array_equal(counts, [1, 2, 2, 1, 1])
    np.testing.assert_array_equal(columns["depth"], [10.0, 20.0, 21.0, 30.0, 31.0, 40.0, 50.0])
    np.testing.assert_array_equal(
        columns["residual_east"], [np.nan, 1.0, 2.0, np.nan, np.nan, 3.0, np.nan]
    )
    # one that no message has takes no memory
    assert columns["replayed_residual_east"].strides == (0,)
    np.testing.assert_array_equal(columns["replayed_residual_east"], np.full(7, np.nan))


def test_single_values_have_the_types_of_a_table():
    found = SingleValues("Innovation")
    mean = {"kind": "dive", "measured_east": 0.5}
    found.add(
        innovation(
            timestamp={"seconds": 2, "nanos": 3},
            source_topic="/a",
            dof=4,
            accepted=True,
            nis=1.5,
            source_position=7,
        )
    )
    found.add(innovation(timestamp={"seconds": 5}, source_topic="/a", mean_current=mean))
    columns = found.columns()
    np.testing.assert_array_equal(
        columns["timestamp"], np.array([2_000_000_003, 5_000_000_000], dtype="datetime64[ns]")
    )
    assert columns["source_topic"] == ["/a", "/a"]
    assert columns["source_topic"][0] is columns["source_topic"][1]
    for name, kind, expected in (
        ("dof", np.int64, [4, 0]),
        ("accepted", np.bool_, [1, 0]),
        ("nis", np.float64, [1.5, 0.0]),
    ):
        assert columns[name].dtype == kind
        np.testing.assert_array_equal(columns[name], expected)
    assert columns["source_position"].dtype == np.int64
    assert columns["mean_current_kind"] == [np.nan, "dive"]
    assert columns["mean_current_measured_east"] == [np.nan, 0.5]
    # larger than a signed number holds
    large = single_columns(
        [innovation(source_position=7), innovation(source_position=2**64 - 1)], "Innovation"
    )
    assert large["source_position"].tolist() == [7, 2**64 - 1]
