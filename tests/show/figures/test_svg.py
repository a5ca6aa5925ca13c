"""Panels on pages: where values stand, and what axes say."""

import re

import numpy as np
import pytest

from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel
from replay_kit.show.figures.svg import panels_svg


def drawn(x, y, *axes, **look):
    (panel,) = panels_svg(Figure("one", "", [Panel("", *axes, [Mark(x=x, y=y, **look)])]))
    return panel


@pytest.mark.parametrize("seconds", [40, 540, 6e3, 3e4, 1e5, 6e5, 5e6, 4e7, 4e8])
def test_an_axis_of_time_has_ticks_at_whole_times_for_every_span(seconds):
    times = np.datetime64("2018-11-16T05:07:03", "ms") + np.array([0, int(1e3 * seconds)])
    svg, about = drawn(times, times.astype(float), Axis(""), Axis("value"), kind="line")
    below = re.findall(r'text-anchor="middle">([^<]+)</text>', svg)
    assert 2 <= len(below) <= 7
    assert all(re.fullmatch(r"\d+ \w{3}|\d\d:\d\d(:\d\d)?", text) for text in below)
    assert about["ends"][0][0] < times.astype(float)[0] < about["ends"][0][1]


def test_values_stand_at_their_places_with_a_gap_where_one_is_unknown():
    x, y = np.array([0.0, 1.0, 2.0, 4.0, 5.0]), np.array([1.0, 2.0, np.nan, 4.0, 5.0])
    svg, about = drawn(x, y, Axis("", ends=(0.0, 5.0)), Axis("", ends=(5.0, 0.0)), kind="line")
    _, _, wide, high = about["box"]
    path = re.search(r'd="([^"]*)" style="fill:none;stroke:var\(--one\)', svg)[1]
    assert path.count("M") == 2
    places = np.array(re.findall(r"[ML]([\d.]+) ([\d.]+)", path), float) / [wide, high]
    known = np.isfinite(y)
    np.testing.assert_allclose(places, np.column_stack([x, y])[known] / 5.0, atol=5e-4)


def test_a_bar_is_as_wide_as_its_bin_and_an_error_as_long_as_stated():
    x, y = np.arange(4.0), np.full(4, 2.0)
    ends = Axis("", ends=(0.0, 4.0)), Axis("", ends=(0.0, 4.0))
    svg, about = drawn(x, y, *ends, kind="bars")
    _, _, wide, high = about["box"]
    assert f"M{wide / 8:.1f} {high:g}V{high / 2:.1f}H{3 * wide / 8:.1f}" in svg
    svg, _ = drawn(x, y, *ends, kind="points", error=np.ones(4))
    assert f"M{wide / 4:.1f} {3 * high / 4:.1f}V{high / 4:.1f}" in svg
