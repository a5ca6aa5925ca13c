"""PD0 files whose configuration changes midway, and ensembles with leaders that are short: each is read by its own."""

import struct
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.core.errors import LogError
from replay_kit.core.observation import Observation
from replay_kit.logs import open_log
from replay_kit.measurements import observations
from tests.logs.adcp import raw_adcp_samples as samples
from tests.logs.adcp.raw_adcp_samples import Survey, adcp_messages, ensemble, packet, pd0, write

SURVEY = Survey(shear=(0.02, -0.01, 0.0), pitch=0.0, roll=0.0)
CHANGED = replace(SURVEY, cells=7, cell=2.0, system="earth")


def joined(surveys):
    """Return a file whose ensembles are of the survey that begins at or before them."""
    begins = sorted(surveys)
    return b"".join(
        samples.ensemble(surveys[max(at for at in begins if at <= k)], k) for k in range(30)
    )


def profiles(path):
    return [
        value for value in observations(open_log(path).messages()) if isinstance(value, Observation)
    ]


def test_each_ensemble_is_read_by_its_own_leader(tmp_path):
    path = write(tmp_path, joined({0: SURVEY, 10: CHANGED, 25: SURVEY}))
    pings, fixes = adcp_messages(path)
    assert [ping.payload["ping"] for ping in pings] == list(range(30))
    assert len(fixes) == 30
    for k, ping in enumerate(pings):
        survey = CHANGED if 10 <= k < 25 else SURVEY
        stated = {
            "n_cells": survey.cells,
            "cell_size": survey.cell,
            "coordinate_system": survey.system,
        }
        assert stated.items() <= ping.payload.items()
        assert len(ping.payload["velocity"]) == survey.cells
    # what it means, in the sea: both give the same current at their own depths
    for k, profile in enumerate(profiles(path)):
        survey = CHANGED if 10 <= k < 25 else SURVEY
        distance = samples.FIRST_CELL + survey.cell * np.arange(survey.cells)
        np.testing.assert_allclose(profile.depth, 0.7 + distance, atol=1e-9)
        truth = np.array(survey.water) + distance[:, None] * np.array(survey.shear)
        np.testing.assert_allclose(profile.velocity, truth[:, :2], atol=0.006)


@pytest.mark.parametrize(
    ("begins", "told"),
    [
        ({0: SURVEY, 10: CHANGED, 25: SURVEY}, "from ping 10, 25 on"),
        ({0: SURVEY, 29: replace(SURVEY, up=True)}, "from ping 29 on"),
        ({0: SURVEY, 29: replace(SURVEY, stated_declination=2.5)}, "from ping 29 on"),
        ({0: SURVEY, 29: replace(SURVEY, firmware=(51, 41))}, "from ping 29 on"),
        (
            {k: CHANGED if k % 2 else SURVEY for k in range(30)},
            "from ping 1, 2, 3, 4, 5, 6, 7, 8, 9 on",
        ),
    ],
)
def test_a_change_is_told_with_its_ping(tmp_path, begins, told):
    log = open_log(write(tmp_path, joined(begins)))
    assert list(log.messages())
    words = f"the instrument's configuration changes, each ping uses its own: {told}"
    assert log.report().notes == (words,)


@pytest.mark.parametrize("firmware", [(51, 40), (8, 12)])
@pytest.mark.parametrize("leader", [65, 57, 56, 55, 42, 28])
def test_a_short_variable_leader_is_read(tmp_path, leader, firmware):
    survey = replace(SURVEY, leader=leader, firmware=firmware, gps=False, bottom_track=False, n=5)
    pings, _ = adcp_messages(write(tmp_path, samples.pd0(survey)))
    whole, _ = adcp_messages(
        write(tmp_path, samples.pd0(replace(survey, leader=None, firmware=(51, 40))))
    )
    assert len(pings) == 5
    for ping, other in zip(pings, whole, strict=True):
        assert ping.time_ns == other.time_ns
        for name in (
            "velocity",
            "heading",
            "pitch",
            "roll",
            "temperature",
            "sound_speed",
            "n_cells",
        ):
            assert ping.payload[name] == other.payload[name]
        assert ping.payload["transducer_depth"] == other.payload["transducer_depth"] == 0.7


def test_the_pressure_of_a_leader_that_ends_before_it_is_not_zero(tmp_path):
    def with_sensor(survey):
        data = bytearray(samples.ensemble(survey, 0))
        at = struct.unpack_from("<H", data, 6)[0] + 31
        # a pressure sensor is available
        data[at] |= 0b00100000
        struct.pack_into("<H", data, len(data) - 2, sum(data[:-2]) & 0xFFFF)
        return write(tmp_path, bytes(data))

    survey = replace(SURVEY, gps=False, n=1)
    (whole,), _ = adcp_messages(with_sensor(survey))
    assert (whole.payload["pressure"], whole.payload["transducer_depth"]) == (0.0, 0.0)
    (short,), _ = adcp_messages(with_sensor(replace(survey, leader=55)))
    # the depth that the leader has besides stands for it
    assert (short.payload["pressure"], short.payload["transducer_depth"]) == (None, 0.7)


def test_what_an_ensemble_lacks_is_said(tmp_path):
    short, few = replace(SURVEY, leader=27), bytearray(samples.ensemble(SURVEY, 1))
    # its leader states a cell more than its blocks hold
    few[struct.unpack_from("<H", few, 6)[0] + 9] += 1
    struct.pack_into("<H", few, len(few) - 2, sum(few[:-2]) & 0xFFFF)
    log = open_log(
        write(
            tmp_path,
            samples.ensemble(SURVEY, 0)
            + bytes(few)
            + samples.ensemble(short, 2)
            + samples.ensemble(SURVEY, 3),
        )
    )
    assert [m.payload["ping"] for m in log.messages() if m.topic == "/adcp"] == [0, 3]
    assert log.report().read["/adcp"] == 4
    assert log.report().undecodable["/adcp"] == (
        2,
        "ensemble whose block 0x0100 has 98 bytes, 106 are needed for 13 cells",
    )
    with pytest.raises(
        LogError,
        match=r"no ensemble can be read: 30 x ensemble whose variable leader has 27 bytes, 28 are needed",
    ):
        open_log(write(tmp_path, samples.pd0(short)))


@pytest.mark.parametrize("kind", [0x79, 0x7A, 0x31])
def test_packets_of_other_kinds_are_skipped_and_counted(tmp_path, kind):
    survey = Survey(n=6, system="earth")
    packets = [packet(kind, bytes(range(size))) for size in (0, 1, 80, 200)]
    alone = open_log(write(tmp_path, pd0(survey)))
    expected = list(alone.messages())
    whole = b"".join(
        ensemble(survey, k) + (packets[k] if k < len(packets) else b"") for k in range(survey.n)
    )
    for before in ([], packets if kind == 0x79 else []):
        log = open_log(write(tmp_path, b"".join(before) + whole))
        assert [m.payload for m in log.messages()] == [m.payload for m in expected]
        assert log.report().losses == ()
        count = len(before) + len(packets)
        name = ", waves" if kind == 0x79 else ""
        assert (
            f"{count} packets of another kind (7F {kind:02X}{name}), skipped" in log.report().notes
        )
    # what has the kind and not the checksum is no packet
    log = open_log(write(tmp_path, whole + packets[-1][:-1] + b"\xff"))
    assert len(list(log.messages())) == len(expected)
    assert [loss.bytes for loss in log.report().losses] == [len(packets[-1])]


def test_bottom_track_alone_says_what_it_holds(tmp_path):
    path = write(tmp_path, pd0(Survey(profile=False)))
    log = open_log(path)
    messages = list(log.messages())
    fixes = [m.payload["latitude"] for m in messages if m.topic == "/vehicle/fix"]
    assert len(fixes) == 30
    pings = [m.payload for m in messages if m.topic == "/adcp"]
    assert all(ping["n_cells"] == 0 and ping["bottom_track"]["velocity"] for ping in pings)
    assert log.report().notes[0].startswith("bottom track and fixes alone")
