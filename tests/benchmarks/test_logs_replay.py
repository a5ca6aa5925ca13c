"""What the row of a whole replay compares: all pings were judged, whatever the judgement."""

import numpy as np
import pytest

from replay_kit.config.run import RunConfig
from replay_kit.forecast import read_truth
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.studies.twins import Twin, make_twin
from tests import synthetic
from tests.benchmarks.logs_replay import decisions, whole_row

PINGS = 24


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ocean")
    ds = synthetic.dataset(seed=4, n_members=21, shape=(6, 7))
    ds.isel(member=slice(20)).to_netcdf(folder / "ensemble.nc", engine="h5netcdf")
    ds.isel(member=20, drop=True).to_netcdf(folder / "truth.nc", engine="h5netcdf")
    make_twin(
        read_truth(str(folder / "truth.nc"), RunConfig().forecast),
        Twin("vessel", PINGS, 0.05, 1),
        folder / "survey.mcap",
    )
    return folder


def changed(log, out, change):
    """Write a log with each ping's payload changed, given its number; None leaves the ping out."""
    messages, n = [], 0
    for message in open_log(log).messages():
        if "velocity" in message.payload:
            payload, n = change(n, dict(message.payload)), n + 1
            messages += [] if payload is None else [message._replace(payload=payload)]
        else:
            messages.append(message)
    assert n == PINGS
    write_mcap_log(out, messages)
    return out


def shifted(payload, by):
    """A ping's payload with all of its velocities off by so much [m/s]."""
    velocity = [
        [None if value is None else value + by for value in cell] for cell in payload["velocity"]
    ]
    return payload | {"velocity": velocity}


def row_of(ocean, name, change):
    log = changed(ocean / "survey.mcap", ocean / f"{name}.mcap", change)
    return whole_row(log, ocean / "ensemble.nc", ocean, PINGS, 8)


def test_pings_that_the_gate_rejects_are_no_difference_but_are_said(ocean):
    # one 3 m/s off beside those that so few modes do not fit
    row = row_of(
        ocean, "gated", lambda n, payload: shifted(payload, 3.0) if n == PINGS - 2 else payload
    )
    assert row["error"] == {"messages_differ": 0.0, "messages_not_judged": 0.0}
    assert row["profiles_gated"] > 0
    assert row["profiles_used"] + row["profiles_gated"] == PINGS


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("lost", lambda n, payload: None if n == 5 else payload),
        ("unusable", lambda n, payload: shifted(payload, np.nan) if n == 5 else payload),
    ],
)
def test_a_ping_that_is_lost_or_unusable_is_a_difference(ocean, name, change):
    row = row_of(ocean, name, change)
    assert row["error"] == {"messages_differ": 0.0, "messages_not_judged": 1.0}
    assert row["profiles_used"] + row["profiles_gated"] == PINGS - 1


def test_a_ping_that_comes_twice_is_not_judged_twice(ocean):
    log, messages = ocean / "twice.mcap", list(open_log(ocean / "survey.mcap").messages())
    last = next(message for message in reversed(messages) if "velocity" in message.payload)
    write_mcap_log(log, [*messages, last._replace(topic="/again")])
    row = whole_row(log, ocean / "ensemble.nc", ocean, PINGS, 8)
    assert row["error"]["messages_differ"] == 0.0
    assert (
        sum(decisions(ocean / "out.mcap").values()) - decisions(ocean / "out.mcap")["repeated"]
        == PINGS
    )
