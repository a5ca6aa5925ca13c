"""AD2CP files: bottom-track records give the platform's velocity over the ground; a file with one whole ping is read."""

from collections import Counter
from dataclasses import replace
from datetime import timedelta

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.adcp.bottom_track import NOT_FOUND
from tests.logs.adcp import ad2cp_samples as samples
from tests.logs.adcp.ad2cp_samples import Survey
from tests.logs.adcp.raw_adcp_samples import adcp_messages, nortek_record, write
from tests.measurements.turned import turned


def pings(folder, survey, n=5):
    return [
        message.payload for message in adcp_messages(write(folder, samples.ad2cp(survey, n)))[0]
    ]


@pytest.mark.parametrize("down", [True, False])
@pytest.mark.parametrize(
    ("system", "bottom_system"),
    [
        ("beam", "beam"),
        ("instrument", "instrument"),
        ("earth", "earth"),
        ("beam", "instrument"),
        ("instrument", "beam"),
    ],
)
def test_the_platforms_velocity_is_minus_that_of_the_bottom(tmp_path, system, bottom_system, down):
    survey = Survey(system=system, bottom_system=bottom_system, down=down)
    found = pings(tmp_path, survey)
    assert len(found) == 5
    for payload in found:
        assert payload["coordinate_system"] == system
        # of instrument and earth coordinates the two verticals are one
        assert len(payload["bottom_track"]["velocity"]) == (4 if system == "beam" else 3)
        assert payload["bottom_track"]["distance"] == [30.0, 31.0, 32.0, 33.0]
        ping = turned(payload, MeasurementConfig())
        assert ping.absolute
        assert ping.added[:2] == pytest.approx(survey.platform[:2], abs=0.003)
        np.testing.assert_allclose(
            ping.velocity[:3, :2], np.tile(survey.water[:2], (3, 1)), atol=0.004
        )


def test_velocities_have_the_scaling_of_their_record_and_begin_where_it_says(tmp_path):
    survey = Survey(scaling=-4)
    parts = [samples.burst(survey, 0), samples.bottom(survey, 0, offset=82)]
    parts += [samples.burst(survey, 9), samples.bottom(replace(survey, scaling=-3), 9)]
    pings, _ = adcp_messages(write(tmp_path, samples.text() + b"".join(parts)))
    expected = samples.in_system(survey, -np.array(survey.platform), "beam")
    for ping, atol in zip(pings, (0.00005, 0.0005), strict=True):
        velocity = ping.payload["bottom_track"]["velocity"]
        np.testing.assert_allclose(velocity, expected, atol=atol)


def test_bottom_tracks_that_cannot_be_used_are_counted(tmp_path):
    body = samples.bottom(Survey(), 0)[10:]
    none = body[:2] + b"\x00\x00" + body[4:]
    cases = {
        "bottom track of 77 bytes, 78 are needed": body[:77],
        "bottom track shorter than its configuration says": body[:-1],
        "bottom track without velocities, or in unknown coordinates": none,
        "bottom track without a time": body[:9] + b"\x0c" + body[10:],
        "bottom track in coordinates that cannot be turned to those of the pings": samples.bottom(
            Survey(bottom_system="earth"), 0
        )[10:],
    }
    for why, content in cases.items():
        record = nortek_record(samples.BOTTOM, content)
        log = open_log(write(tmp_path, samples.text() + samples.burst(Survey(), 0) + record))
        assert {m.payload["bottom_track"] for m in log.messages()} == {None}
        assert log.report().undecodable == {"/adcp/bottom_track": (1, why)}


def test_a_beam_that_found_no_bottom_is_left_out(tmp_path):
    for survey in (
        Survey(missing_beam=2),
        Survey(distance_mm=(30_000, 31_000, 0, 33_000)),
        Survey(merit=(120, 130, 1000, 150)),
    ):
        track = pings(tmp_path, survey)[0]["bottom_track"]
        assert [value is None for value in track["velocity"]] == [False, False, True, False]
        assert [value is None for value in track["distance"]] == [False, False, True, False]
    assert (
        None
        not in pings(tmp_path, Survey(merit=(999, 999, 999, 999)))[0]["bottom_track"]["velocity"]
    )
    # east, north and up need all beams
    log = open_log(
        write(
            tmp_path,
            samples.ad2cp(
                Survey(system="earth", bottom_system="earth", merit=(120, 130, 1000, 150))
            ),
        )
    )
    assert {m.payload["bottom_track"] for m in log.messages()} == {None}
    assert log.report().undecodable == {"/adcp/bottom_track": (5, NOT_FOUND)}


def test_a_bottom_track_belongs_to_the_ping_beside_it(tmp_path):
    near, far = (
        Survey(bottom_after=timedelta(seconds=-3)),
        Survey(bottom_after=timedelta(seconds=-3, milliseconds=-1)),
    )
    one = samples.text() + samples.burst(near, 0)
    for survey, found in ((near, True), (far, False)):
        (ping,) = (
            m.payload for m in open_log(write(tmp_path, one + samples.bottom(survey, 0))).messages()
        )
        assert (ping["bottom_track"] is not None) is found
    # of several the nearest in time
    data = samples.text() + b"".join(samples.burst(near, k) for k in range(4))
    slow, fast = Survey(), Survey(platform=(2.2, 1.4, 0.0))
    data += samples.bottom(slow, 0) + samples.bottom(fast, 3)
    along = [
        m.payload["bottom_track"]["velocity"][0] for m in open_log(write(tmp_path, data)).messages()
    ]
    assert along[0] == along[1] == pytest.approx(along[2] / 2, abs=0.001)
    assert along[2] == along[3]


def test_one_whole_ping_of_a_cut_file_is_read(tmp_path):
    survey = Survey()
    whole = samples.ad2cp(survey, 3)
    first = len(samples.text()) + len(samples.burst(survey, 0))
    for end in (first, first + 30, first + len(samples.bottom(survey, 0)) + 50):
        log = open_log(write(tmp_path, whole[:end]))
        (ping,) = log.messages()
        assert (ping.time_ns, ping.payload["ping"]) == (int(samples.START.timestamp()) * 10**9, 0)
        assert ping.payload["velocity"] == pings(tmp_path, survey, 3)[0]["velocity"]
        assert len(log.report().losses) == (end > first)
    with pytest.raises(LogError, match="no valid ensemble of velocities"):
        open_log(write(tmp_path, whole[: first - 1]))


def _text_of_both():
    """Return the record with the configuration of an instrument that averages, too."""
    text = samples.text()
    lines = text[text[1] :].split(b"\r\n")
    more = [
        line.replace(b"BURST", b"AVG") + b",AI=30,BW=25"
        for line in lines
        if line.startswith((b"GETXFBURST", b"GETBURST"))
    ]
    return nortek_record(samples.TEXT, b"\r\n".join([lines[0], *more, *lines[1:]]))


def _as_average(record):
    """Return a burst as the record of an averaging mode."""
    return nortek_record(0x16, record[record[1] :])


def test_modes_of_unequal_numbers_are_streams_of_their_own(tmp_path):
    bursts = [samples.burst(Survey(), k) for k in range(7)]
    averages = [_as_average(samples.burst(Survey(water=(0.1, 0.1, 0.0)), k)) for k in (1, 4)]
    log = open_log(write(tmp_path, b"".join([_text_of_both(), *bursts, *averages])))
    found = list(log.messages())
    assert Counter(m.topic for m in found) == {"/adcp": 7, "/adcp/average": 2}
    alone = pings(tmp_path, Survey(), 7)
    assert [m.payload["velocity"] for m in found if m.topic == "/adcp"] == [
        ping["velocity"] for ping in alone
    ]
    (said,) = log.report().notes
    assert said.startswith("2 configurations, each a stream of pings: /adcp (7 pings of 6 cells")
    assert not log.report().losses


@pytest.mark.parametrize("apart", [True, False])
def test_configurations_are_split(tmp_path, apart):
    one, other = Survey(), Survey(system="earth", water=(0.2, 0.1, 0.0))
    texts = [samples.text(), samples.text().replace(b"DECL=3.50", b"DECL=4.50")]
    texts[1] = nortek_record(samples.TEXT, texts[1][texts[1][1] :])
    if apart:
        # two recordings one after the other
        parts = [texts[0], *(samples.burst(one, k) for k in range(4))]
        parts += [texts[1], *(samples.burst(other, k) for k in range(4, 9))]
    else:
        # plans in turn
        parts = [texts[0], *(samples.burst(other if k % 2 else one, k) for k in range(9))]
    log = open_log(write(tmp_path, b"".join(parts)))
    found = list(log.messages())
    counts = {"/adcp": 4, "/adcp/2": 5} if apart else {"/adcp": 5, "/adcp/2": 4}
    assert Counter(m.topic for m in found) == counts
    systems = {m.topic: m.payload["coordinate_system"] for m in found}
    assert systems == {"/adcp": "beam", "/adcp/2": "earth"}
    stated = {m.topic: m.payload["magnetic_declination"] for m in found}
    assert stated == {"/adcp": 3.5, "/adcp/2": 4.5 if apart else 3.5}
    (ping,) = [m.payload for m in found if m.topic == "/adcp/2"][:1]
    moved = np.subtract(other.water, other.platform)
    np.testing.assert_allclose(ping["velocity"][0][:2], moved[:2], atol=0.001)


def test_a_configuration_that_cannot_be_read_costs_its_own_pings_alone(tmp_path):
    odd = bytearray(samples.burst(Survey(), 2))
    # three beams are claimed of a record that holds four
    odd[odd[1] + 30 : odd[1] + 32] = (9 << 12 | 3 << 10 | 6).to_bytes(2, "little")
    record = nortek_record(samples.BURST, bytes(odd[odd[1] :]))
    data = samples.text() + b"".join(samples.burst(Survey(), k) for k in (0, 1)) + record
    log = open_log(write(tmp_path, data))
    assert Counter(m.topic for m in log.messages()) == {"/adcp": 2}
    ((topic, (count, why)),) = log.report().undecodable.items()
    assert (topic, count) == ("/adcp/2", 1)
    assert "configuration that cannot be read" in why
