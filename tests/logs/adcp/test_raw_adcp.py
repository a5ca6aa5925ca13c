"""Raw Teledyne and Nortek files made with a known truth, whole and damaged."""

import struct
import sys
from datetime import timedelta

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs.adcp.frames import AD2CP_TEXT, scan
from replay_kit.logs.adcp.profiles import clock_offset, declination_at
from replay_kit.measurements import observations
from tests.logs.adcp import raw_adcp_samples as samples
from tests.logs.adcp.raw_adcp_samples import Survey, pd0
from tests.logs.log_samples import SECOND
from tests.logs.log_samples import read_log as read
from tests.reference import frames as slow
from tests.reference.adcp_records import slow_records

START_NS = int(samples.START.timestamp()) * SECOND


@pytest.mark.parametrize(
    "survey",
    [
        *(Survey(system=system) for system in ("beam", "instrument", "ship", "earth")),
        Survey(up=True),
        Survey(system="earth", stated_declination=15.8),
    ],
)
def test_a_vessels_file_says_what_was_stored(tmp_path, survey):
    pings = [m.payload for m in read(tmp_path, pd0(survey))[0] if m.topic == "/adcp"]
    assert len(pings) == survey.n
    turned = survey.system in ("ship", "earth")
    stored = np.where(samples.velocity(survey) < -9999, None, 1e-3 * samples.velocity(survey))
    same = {
        **{"coordinate_system": survey.system, "reference": "platform"},
        **{"orientation": "up" if survey.up else "down", "attitude_convention": "teledyne"},
        **{"tilt_applied": turned, "bin_mapped": turned, "transducer_depth": 0.7},
        **{"n_cells": 12, "cell_size": 1.0, "bin0_distance": 2.0},
        "declination_applied": survey.stated_declination > 0.0,
    }
    for ping in (pings[0], pings[15]):
        assert ping == ping | same
        angles = ping["heading"], ping["pitch"], ping["roll"], ping["magnetic_declination"]
        # that of the model, of the place and day
        assert angles == pytest.approx((54.2, 6.0, -9.0, 15.8), abs=0.1)
        beams = slow.janus_vectors(samples.ANGLE)
        np.testing.assert_allclose(ping["beam_unit_vectors"], beams, atol=1e-12)
        assert [*map(len, ping["velocity"])] == [4] * 12
        assert ping["velocity"][3][2] is None
        for cell, values in zip(ping["velocity"], stored.tolist(), strict=True):
            assert cell == pytest.approx(values, abs=1e-9)
        track = {"velocity": [1e-3 * of for of in samples.BOTTOM], "distance": [50.0] * 4}
        assert {name: pytest.approx(of) for name, of in ping["bottom_track"].items()} == track


def test_without_bottom_track_the_vessels_velocity_is_that_of_its_gps(tmp_path):
    messages, _ = read(tmp_path, pd0(Survey(bottom_track=False)))
    assert not any("platform_velocity" in m.payload for m in messages)
    for profile in observations(messages):
        assert (profile.reference, profile.common_std < 0.5) == ("earth", True)
        moved = pytest.approx(samples.VESSEL, abs=3.0 * profile.common_std)
        assert profile.platform_velocity == moved
        np.testing.assert_allclose(profile.depth, 0.7 + 2.0 + np.arange(12), atol=1e-9)
        np.testing.assert_allclose(profile.error_std, 0.09)


def test_gps_sets_the_clock_right_over_midnight(tmp_path):
    messages, _ = read(tmp_path, pd0(Survey()))
    pings, fixes = ([m for m in messages if m.topic == at] for at in ("/adcp", "/vehicle/fix"))
    assert pings[3].payload["clock_offset"] == samples.CLOCK_BEHIND.total_seconds()
    for each in (pings, fixes):
        assert [m.time_ns for m in each] == [START_NS + k * SECOND for k in range(30)]
    place = fixes[0].payload["longitude"], fixes[0].payload["latitude"]
    assert place == pytest.approx((samples.LONGITUDE, samples.LATITUDE))
    ping = read(tmp_path, pd0(Survey(gps=False)))[0][0]
    assert ping.payload["clock_offset"] is None
    assert ping.time_ns == START_NS - samples.CLOCK_BEHIND // timedelta(seconds=1) * SECOND


_NO_TEXT = samples.nortek_record(AD2CP_TEXT, b"\x10no configuration\x00")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x7f\x7f" * 4000, "no valid ensemble"),
        (b"\xa5\x0a" + bytes(500), "no valid ensemble"),
        (samples.nortek_record(0x15, bytes(80)), "configuration is missing"),
        (_NO_TEXT + 3 * samples.nortek_record(0x15, bytes(80)), "MHKiT cannot read"),
    ],
)
def test_a_file_without_a_sound_ensemble_is_an_error(tmp_path, data, words):
    with pytest.raises(LogError, match=words):
        read(tmp_path, data)


def test_without_mhkit_the_extra_is_named(tmp_path, monkeypatch):
    for name in ("mhkit", "mhkit.dolfyn.io.nortek2", "mhkit.dolfyn.io.rdi"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(LogError, match=r"pip install 'replay-kit\[adcp\]'"):
        read(tmp_path, pd0(Survey(n=2)))


def _pd0_record(leader, filling, types=1):
    """Return an ensemble whose first type is a leader, or not, with its checksum."""
    body = struct.pack(
        "<HHBBH", 0x7F7F, 8 + 2 * types + len(filling), 0, types, 6 + 2 * types
    ) + bytes(2 * types - 2)
    body += struct.pack("<H", leader) + filling
    return body + struct.pack("<H", sum(body) & 0xFFFF)


def _pieces(magic, rng):
    """Return records of even and odd lengths, the shortest among them, and what only looks like one."""
    fillings = [rng.bytes(size) for size in (0, 1, 2, 7, 8, 15, 16, 17, 33, 300)]
    if magic == b"\xa5\x0a":
        record = samples.nortek_record
        sound = [record(k, filling, k % 2) for k, filling in enumerate(2 * fillings)]
        # one record inside another, and a header without its record
        inside = record(0x15, sound[5] + sound[8])
        return [*sound, inside, sound[-1][:10], bytes([0xA5, 11]) + sound[4][2:]]
    sound = [_pd0_record(k % 2, filling, 1 + k % 3) for k, filling in enumerate(fillings)]
    return [
        *sound,
        # packets of waves, and one that only looks like it
        samples.packet(0x79, sound[2]),
        samples.packet(0x79, rng.bytes(40)),
        samples.packet(0x12, b"")[:-1],
        _pd0_record(2, b""),
        _pd0_record(0, sound[3] + sound[4]),
        struct.pack("<HHBBH", 0x7F7F, 8, 0, 0, 6),
        b"\x7f\x7f\x7f",
    ]


@pytest.mark.parametrize("magic", [b"\xa5\x0a", b"\x7f\x7f"])
def test_records_are_found_as_by_a_walk(magic):
    rng = np.random.default_rng(5)
    pieces = _pieces(magic, rng)
    data = magic + b"".join(
        pieces[k] + rng.bytes(int(rng.integers(3))) for k in rng.permutation(len(pieces))
    )
    nortek = magic == b"\xa5\x0a"
    assert len(slow_records(data, nortek)) == (21 if nortek else 13)
    damaged = bytearray(data)
    damaged[len(data) // 3 :: 200] = bytes(len(damaged[len(data) // 3 :: 200]))
    # cut in the last record, at its end, and with what might begin another; on odd offsets too
    ends = data[:-1], data + magic[:1], data + pieces[0], data + pieces[0][:-1]
    for file in (data, *ends, bytes(damaged), magic, magic + b"?" + data):
        found = [(record.start, record.end, record.kind) for record in scan(file)]
        assert found == slow_records(file, nortek)


def test_a_clock_without_a_date_is_right_within_half_a_day():
    gps, hour = np.arange(5.0) * 1000.0, 3_600_000.0
    for behind, dated, offset in ((8, False, 8), (-16, False, 8), (-16, True, -16)):
        assert clock_offset(gps, gps - behind * hour, dated) == offset * hour


def test_the_declination_is_that_of_the_time_and_none_before_2010():
    # the vessel of vmdas01_wh.ENX stated 15.8 degrees for this place and day
    day, earlier, before = (s * SECOND for s in (1_597_845_425, 1_297_845_425, 1_100_000_000))
    stated = declination_at(day, -123.04, 48.08)
    assert stated == pytest.approx(15.8, abs=0.1)
    assert declination_at(earlier, -123.04, 48.08) not in (stated, None)
    assert declination_at(before, 0.0, 0.0) is None
