"""PD0 files whose configuration changes midway: each ensemble is read by its own."""

import struct
from dataclasses import replace

import pytest

from replay_kit.core.errors import LogError
from tests.logs.adcp import raw_adcp_samples as samples
from tests.logs.adcp.raw_adcp_samples import Survey, adcp_messages, ensemble, packet, pd0
from tests.logs.log_samples import read_log as read

SURVEY = Survey()
CHANGED = replace(SURVEY, cells=7, cell=2.0, system="earth")


def joined(surveys):
    """Return a file whose ensembles are of the survey that begins at or before them."""
    return b"".join(
        ensemble(surveys[max(at for at in surveys if at <= k)], k) for k in range(SURVEY.n)
    )


def edited(data, change):
    """Return an ensemble whose fixed leader is changed, with its checksum."""
    data = bytearray(data)
    change(data, struct.unpack_from("<H", data, 6)[0])
    struct.pack_into("<H", data, len(data) - 2, sum(data[:-2]) & 0xFFFF)
    return bytes(data)


def test_each_ensemble_is_read_by_its_own_leader(tmp_path):
    messages, report = read(tmp_path, joined({0: SURVEY, 10: CHANGED, 25: SURVEY}))
    assert report.notes[0].endswith("each ping uses its own: from ping 10, 25 on")
    pings = [m.payload for m in messages if m.topic == "/adcp"]
    assert [ping["ping"] for ping in pings] == list(range(30))
    assert len(messages) == 60
    for k, ping in enumerate(pings):
        survey = CHANGED if 10 <= k < 25 else SURVEY
        told = ping["coordinate_system"], ping["cell_size"], ping["velocity"][-1]
        stored = pytest.approx((1e-3 * samples.velocity(survey)[-1]).tolist())
        assert told == (survey.system, survey.cell, stored)


@pytest.mark.parametrize(
    "change", [{"up": True}, {"stated_declination": 2.5}, {"firmware": (51, 41)}]
)
def test_a_change_is_told_with_its_ping(tmp_path, change):
    begins = {0: SURVEY, 2: replace(SURVEY, **change)}
    _, report = read(tmp_path, joined(begins)[: 3 * len(ensemble(SURVEY, 0))])
    assert report.notes[0].endswith("each ping uses its own: from ping 2 on")


@pytest.mark.parametrize("firmware", [(51, 40), (8, 12)])
def test_the_leader_is_read_whatever_the_firmware(tmp_path, firmware):
    whole = replace(SURVEY, gps=False, bottom_track=False, n=3)
    short = replace(whole, leader=65, firmware=firmware)
    (found, _), (expected, _) = (read(tmp_path, pd0(survey)) for survey in (short, whole))
    names = [
        "velocity",
        "heading",
        "pitch",
        "roll",
        "temperature",
        "sound_speed",
        "n_cells",
        "transducer_depth",
    ]
    assert len(found) == 3
    for ping, other in zip(found, expected, strict=True):
        assert ping.time_ns == other.time_ns
        assert [ping.payload[name] for name in names] == [other.payload[name] for name in names]
        assert ping.payload["transducer_depth"] == 0.7


def test_what_an_ensemble_lacks_is_said(tmp_path):
    def with_a_cell_more(data, leader):
        data[leader + 9] += 1

    short, parts = replace(SURVEY, leader=64), [ensemble(SURVEY, k) for k in range(4)]
    parts[1:3] = edited(parts[1], with_a_cell_more), ensemble(short, 2)
    messages, report = read(tmp_path, b"".join(parts))
    assert [m.payload["ping"] for m in messages if m.topic == "/adcp"] == [0, 3]
    assert report.read["/adcp"] == 4
    count, why = report.undecodable["/adcp"]
    assert count == 2
    assert "block 0x0100 has 98 bytes, 106 are needed for 13 cells" in why
    with pytest.raises(LogError, match="30 x ensemble whose variable leader has 64 bytes, 65 are"):
        read(tmp_path, pd0(short))


def test_a_configuration_that_mhkit_cannot_read_is_counted_and_the_others_come(tmp_path):
    """As of damage that leaves the sum of the bytes as it was, and looks like another configuration."""

    def with_a_letter_in_its_clock(data, _):
        data[data.index(b"$GPGGA,") + 8] = ord("r")

    parts = [ensemble(SURVEY, k) for k in range(4)]
    parts[2] = edited(ensemble(CHANGED, 2), with_a_letter_in_its_clock)
    messages, report = read(tmp_path, b"".join(parts))
    assert [m.payload["ping"] for m in messages if m.topic == "/adcp"] == [0, 1, 3]
    count, why = report.undecodable["/adcp"]
    assert (count, "configuration that cannot be read: MHKiT" in why) == (1, True)
    with pytest.raises(LogError, match="MHKiT cannot read this raw ADCP file: ValueError"):
        read(tmp_path, parts[2])


@pytest.mark.parametrize("kind", [0x79, 0x31])
def test_packets_of_other_kinds_are_skipped_and_counted(tmp_path, kind):
    survey = Survey(n=6, system="earth")
    packets = [packet(kind, bytes(range(size))) for size in (0, 1, 80, 200)]
    expected = [m.payload for m in read(tmp_path, pd0(survey))[0]]
    ensembles = (ensemble(survey, k) for k in range(survey.n))
    whole = b"".join(one + b"".join(packets[k : k + 1]) for k, one in enumerate(ensembles))
    for before in ([], packets if kind == 0x79 else []):
        messages, report = read(tmp_path, b"".join(before) + whole)
        assert [m.payload for m in messages] == expected
        assert report.losses == ()
        name = ", waves" if kind == 0x79 else ""
        words = f"{len(before) + 4} packets of another kind (7F {kind:02X}{name}), skipped"
        assert words in report.notes
    # what has the kind and not the checksum is no packet
    messages, report = read(tmp_path, whole + packets[-1][:-1] + b"\xff")
    assert len(messages) == len(expected)
    assert [loss.bytes for loss in report.losses] == [len(packets[-1])]


def test_bottom_track_alone_says_what_it_holds(tmp_path):
    (tmp_path / "a.pd0").write_bytes(pd0(Survey(profile=False)))
    pings, fixes = adcp_messages(tmp_path / "a.pd0")
    assert len(fixes) == 30
    pings = [m.payload for m in pings]
    assert all(ping["n_cells"] == 0 and ping["bottom_track"]["velocity"] for ping in pings)
    assert read(tmp_path, pd0(Survey(profile=False)))[1].notes[0].startswith("bottom track and fix")
