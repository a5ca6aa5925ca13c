"""AD2CP files: bottom-track records give the platform's velocity over the ground; a file with one whole ping is read."""

from collections import Counter
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.reader import NOT_FOUND
from tests.logs.adcp import ad2cp_samples as samples
from tests.logs.adcp.ad2cp_samples import Survey, bottom, burst, in_system
from tests.logs.adcp.raw_adcp_samples import nortek_record
from tests.logs.log_samples import read_log as read

TEXT = samples.text()


def pings(folder, survey, n=5):
    return [message.payload for message in read(folder, samples.ad2cp(survey, n))[0]]


@pytest.mark.parametrize(
    ("system", "bottom_system", "down"),
    [
        *(("beam", "beam", down) for down in (True, False)),
        *(("instrument", "instrument", True), ("earth", "earth", False)),
        *(("beam", "instrument", False), ("instrument", "beam", True)),
    ],
)
def test_the_bottom_s_velocity_is_along_the_axes_of_the_pings(
    tmp_path, system, bottom_system, down
):
    survey = Survey(system=system, bottom_system=bottom_system, down=down)
    # of instrument and earth coordinates the two verticals are one
    number = 4 if system == "beam" else 3
    along = [in_system(of, system)[:number].tolist() for of in (survey.water, survey.bottom)]
    same = {
        **{"coordinate_system": system, "orientation": "down" if down else "up"},
        **{"attitude_convention": "nortek", "tilt_applied": system == "earth"},
        **{"heading": 70.0, "pitch": 5.0, "roll": -8.0, "reference": "platform"},
        **{"magnetic_declination": 3.5, "declination_applied": True, "bin_mapped": False},
        **{"n_cells": 6, "cell_size": 1.0, "bin0_distance": 1.5},
    }
    found = pings(tmp_path, survey)
    assert len(found) == 5
    for ping in found:
        assert ping == ping | same
        np.testing.assert_allclose(ping["beam_unit_vectors"], samples.vectors(), atol=1e-12)
        np.testing.assert_allclose(ping["velocity"], [along[0]] * 6, atol=0.001)
        np.testing.assert_allclose(ping["bottom_track"]["velocity"], along[1], atol=0.002)
        assert ping["bottom_track"]["distance"] == [30.0, 31.0, 32.0, 33.0]


def test_velocities_have_the_scaling_of_their_record_and_begin_where_it_says(tmp_path):
    survey = Survey(scaling=-4)
    parts = [burst(survey, 0), bottom(survey, 0, offset=82)]
    parts += [burst(survey, 9), bottom(replace(survey, scaling=-3), 9)]
    found, _ = read(tmp_path, TEXT + b"".join(parts))
    expected = in_system(survey.bottom, "beam")
    for ping, atol in zip(found, (0.00005, 0.0005), strict=True):
        velocity = ping.payload["bottom_track"]["velocity"]
        np.testing.assert_allclose(velocity, expected, atol=atol)


_BODY = bottom(Survey(), 0)[10:]


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (_BODY[:77], "bottom track of 77 bytes, 78 are needed"),
        (_BODY[:-1], "bottom track shorter than its configuration says"),
        (_BODY[:2] + bytes(2) + _BODY[4:], "without velocities, or in unknown coordinates"),
        (_BODY[:9] + b"\x0c" + _BODY[10:], "bottom track without a time"),
        (bottom(Survey(bottom_system="earth"), 0)[10:], "cannot be turned to those of the pings"),
    ],
)
def test_bottom_tracks_that_cannot_be_used_are_counted(tmp_path, content, why):
    record = nortek_record(samples.BOTTOM, content)
    messages, report = read(tmp_path, TEXT + burst(Survey(), 0) + record)
    assert {m.payload["bottom_track"] for m in messages} == {None}
    ((topic, (count, words)),) = report.undecodable.items()
    assert (topic, count) == ("/adcp/bottom_track", 1)
    assert why in words


def test_a_beam_that_found_no_bottom_is_left_out(tmp_path):
    one_off = (120, 130, 1000, 150)
    for survey in (
        Survey(missing_beam=2),
        Survey(distance_mm=(30_000, 31_000, 0, 33_000)),
        Survey(merit=one_off),
    ):
        track = pings(tmp_path, survey)[0]["bottom_track"]
        for name in ("velocity", "distance"):
            assert [value is None for value in track[name]] == [False, False, True, False]
    track = pings(tmp_path, Survey(merit=(999,) * 4))[0]["bottom_track"]
    assert None not in track["velocity"]
    # east, north and up need all beams
    turned_there = Survey(system="earth", bottom_system="earth", merit=one_off)
    messages, report = read(tmp_path, samples.ad2cp(turned_there))
    assert {m.payload["bottom_track"] for m in messages} == {None}
    assert report.undecodable == {"/adcp/bottom_track": (5, NOT_FOUND)}


def test_a_bottom_track_belongs_to_the_ping_beside_it(tmp_path):
    for late, found in ((0, True), (-1, False)):
        survey = Survey(bottom_after=timedelta(seconds=-3, milliseconds=late))
        (ping,), _ = read(tmp_path, TEXT + burst(survey, 0) + bottom(survey, 0))
        assert (ping.payload["bottom_track"] is not None) is found
    # of several the nearest in time
    slow, fast = Survey(), Survey(bottom=(-2.2, 1.4, 0.4))
    data = TEXT + b"".join(burst(slow, k) for k in range(4)) + bottom(slow, 0) + bottom(fast, 3)
    along = [m.payload["bottom_track"]["velocity"][0] for m in read(tmp_path, data)[0]]
    assert along == pytest.approx([along[0]] * 2 + [2 * along[0]] * 2, abs=0.002)


def test_one_whole_ping_of_a_cut_file_is_read(tmp_path):
    survey = Survey()
    whole = samples.ad2cp(survey, 3)
    velocity = pings(tmp_path, survey, 3)[0]["velocity"]
    first = len(TEXT) + len(burst(survey, 0))
    for end in (first, first + 30, first + len(_BODY) + 60):
        (ping,), report = read(tmp_path, whole[:end])
        assert (ping.time_ns, ping.payload["ping"]) == (int(samples.START.timestamp()) * 10**9, 0)
        assert ping.payload["velocity"] == velocity
        assert len(report.losses) == (end > first)
    with pytest.raises(LogError, match="no valid ensemble of velocities"):
        read(tmp_path, whole[: first - 1])


def content(record):
    return record[record[1] :]


def test_modes_of_unequal_numbers_are_streams_of_their_own(tmp_path):
    lines = content(TEXT).split(b"\r\n")
    burst_lines = [line for line in lines if line.startswith((b"GETXFBURST", b"GETBURST"))]
    averaging = [line.replace(b"BURST", b"AVG") + b",AI=30,BW=25" for line in burst_lines]
    text = nortek_record(samples.TEXT, b"\r\n".join([lines[0], *averaging, *lines[1:]]))
    bursts = [burst(Survey(), k) for k in range(7)]
    averages = [content(burst(Survey(water=(0.1, 0.1, 0.0)), k)) for k in (1, 4)]
    averages = [nortek_record(0x16, each) for each in averages]
    found, report = read(tmp_path, b"".join([text, *bursts, *averages]))
    assert Counter(m.topic for m in found) == {"/adcp": 7, "/adcp/average": 2}
    velocities = [m.payload["velocity"] for m in found if m.topic == "/adcp"]
    assert velocities == [ping["velocity"] for ping in pings(tmp_path, Survey(), 7)]
    assert "2 configurations, each a stream of pings: /adcp (7 pings of" in report.notes[0]
    assert not report.losses


@pytest.mark.parametrize("apart", [True, False])
def test_configurations_are_split(tmp_path, apart):
    one, other = Survey(), Survey(system="earth", water=(0.2, 0.1, 0.05))
    later = nortek_record(samples.TEXT, content(TEXT).replace(b"DECL=3.50", b"DECL=4.50"))
    # two recordings one after the other, or plans in turn
    second = [k > 3 if apart else k % 2 for k in range(9)]
    parts = [burst(other if second[k] else one, k) for k in range(9)]
    parts = [*parts[:4], later, *parts[4:]] if apart else parts
    found, _ = read(tmp_path, TEXT + b"".join(parts))
    counts = {"/adcp": 4, "/adcp/2": 5} if apart else {"/adcp": 5, "/adcp/2": 4}
    assert Counter(m.topic for m in found) == counts
    said = {
        m.topic: (m.payload["coordinate_system"], m.payload["magnetic_declination"]) for m in found
    }
    assert said == {"/adcp": ("beam", 3.5), "/adcp/2": ("earth", 4.5 if apart else 3.5)}
    ping = next(m.payload for m in found if m.topic == "/adcp/2")
    assert ping["velocity"][0] == pytest.approx(other.water)


def test_a_configuration_that_cannot_be_read_costs_its_own_pings_alone(tmp_path):
    odd = bytearray(content(burst(Survey(), 2)))
    # three beams are claimed of a record that holds four
    odd[30:32] = (9 << 12 | 3 << 10 | 6).to_bytes(2, "little")
    record = nortek_record(samples.BURST, bytes(odd))
    found, report = read(tmp_path, TEXT + burst(Survey(), 0) + burst(Survey(), 1) + record)
    assert Counter(m.topic for m in found) == {"/adcp": 2}
    ((topic, (count, why)),) = report.undecodable.items()
    assert (topic, count) == ("/adcp/2", 1)
    assert "configuration that cannot be read" in why
