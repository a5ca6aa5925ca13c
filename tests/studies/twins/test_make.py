"""Logs of twins: their bytes and messages, other references, faults, mean currents alone."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Observation, PathMean
from replay_kit.logs import merge, open_log
from replay_kit.measurements import observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.make import Twin, make_twin
from tests.faulty import write_glider
from tests.logs.mavlink.telemetry_samples import write_tlog
from tests.studies.twins.truths import LEVELS, make_truth

_PING_KEYS = (
    "stamp frame_id ping coordinate_system reference orientation bin_mapped n_cells cell_size bin0_distance transducer_depth "
    "beam_unit_vectors velocity velocity_std amplitude correlation percent_good sound_speed temperature pressure heading pitch "
    "roll magnetic_declination declination_applied bottom_track"
)


def observed(log: Path) -> list[Observation | PathMean]:
    return list(observations(merge([open_log(log)], 1.0), MeasurementConfig()))


def profiles(found) -> list[Observation]:
    return [each for each in found if isinstance(each, Observation)]


@pytest.mark.parametrize("vehicle", ["vessel", pytest.param("glider", marks=pytest.mark.full)])
def test_the_same_arguments_give_the_same_bytes(tmp_path, vehicle):
    out = tmp_path / "a.mcap"
    made = make_twin(make_truth(), Twin(vehicle, 40, 0.09, 7), out)  # type: ignore[arg-type]
    first = out.read_bytes()
    make_twin(make_truth(), Twin(vehicle, 40, 0.09, 7), out, overwrite=True)  # type: ignore[arg-type]
    assert out.read_bytes() == first
    assert made.pinged.sum() == 40
    make_twin(make_truth(), Twin(vehicle, 40, 0.09, 8), out, overwrite=True)  # type: ignore[arg-type]
    assert out.read_bytes() != first
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_a_ping_is_the_documented_json(tmp_path):
    out = tmp_path / "a.mcap"
    make_twin(make_truth(levels=LEVELS[:4]), Twin("glider", 30, 0.09, 0), out)
    with out.open("rb") as file:
        read = [
            (schema.name, channel.topic, json.loads(message.data))
            for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages()
        ]
    pings = [payload for schema, _, payload in read if schema == "replay_kit.AdcpPing"]
    assert len(pings) == 30
    for number, ping in enumerate(pings):
        assert list(ping) == _PING_KEYS.split()
        assert ping["ping"] == number
        assert len(ping["velocity"]) == ping["n_cells"] == 22
        assert {len(cell) for cell in ping["velocity"]} == {3}
    assert pings[0]["velocity"][-1] == [None, None, None]
    fix = "foxglove.LocationFix"
    assert {(schema, topic) for schema, topic, _ in read} == {
        ("replay_kit.AdcpPing", "/adcp"),
        ("replay_kit.DepthAveragedCurrent", "/dac"),
        *((fix, f"/vehicle/{name}") for name in ("fix", "position")),
    }


@pytest.mark.parametrize("vehicle", ["vessel", pytest.param("glider", marks=pytest.mark.full)])
def test_both_carriers_give_the_same_observations(tmp_path, vehicle):
    truth = make_truth()
    make_twin(truth, Twin(vehicle, 60, 0.09, 3), tmp_path / "a.mcap")  # type: ignore[arg-type]
    write_tlog(tmp_path / "a.tlog", open_log(tmp_path / "a.mcap").messages())
    ours_all, theirs_all = (profiles(observed(tmp_path / f"a.{kind}")) for kind in ("mcap", "tlog"))
    pairs = list(zip(ours_all, theirs_all, strict=True))
    assert len(pairs) == 60
    for ours, theirs in pairs:
        assert ours.time_ns == theirs.time_ns
        # degE7 and float32 are what the wire carries
        assert (ours.longitude, ours.latitude) == pytest.approx(
            (theirs.longitude, theirs.latitude), abs=1.1e-7
        )
        np.testing.assert_allclose(ours.velocity, theirs.velocity, atol=1e-7)
        np.testing.assert_allclose(ours.depth, theirs.depth, atol=1e-3)
        np.testing.assert_allclose(ours.error_std, theirs.error_std, rtol=1e-6)
        assert ours.dive == theirs.dive


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"out": "a.csv"}, "log is .mcap"),
        ({"vehicle": "kite"}, "vessel or glider"),
        ({"pings": 0}, "pings >= 1"),
        ({"noise": float("nan")}, "noise >= 0"),
        ({"seed": -1}, "seed >= 0"),
        ({"out": "there.mcap"}, "exists"),
        ({"out": "no/such/folder/a.mcap"}, "there is no folder"),
    ],
)
def test_bad_arguments_are_refused(tmp_path, change, said):
    (tmp_path / "there.mcap").write_bytes(b"mine")
    out = tmp_path / str(change.pop("out", "a.mcap"))
    with pytest.raises(ConfigError, match=said):
        make_twin(make_truth(), replace(Twin("vessel", 3, 0.1, 0), **change), out)  # type: ignore[arg-type]
    assert (tmp_path / "there.mcap").read_bytes() == b"mine"


def test_mean_currents_are_the_means_along_their_paths(tmp_path):
    truth = make_truth()
    write_glider(truth, Twin("glider", 60, 0.05, 3), tmp_path / "a.mcap", pings=False)
    found = observed(tmp_path / "a.mcap")
    assert [type(each) for each in found] == [PathMean] * 4
    field, projection = build_field(truth), truth.grid.projection
    # positions within the last dive end with the last ping
    for mean in found[:-1]:
        east, north = to_local(projection, mean.longitude, mean.latitude)
        local = mean.weight @ field.velocity(east, north, mean.depth)
        middle = mean.longitude.mean(), mean.latitude.mean()
        stated = rotate_to_local(projection, *middle, *mean.velocity)
        # the path between fixes is dead-reckoned with one current, and a position comes every ten minutes
        np.testing.assert_allclose(local, stated, atol=0.01)
        assert mean.weight @ mean.depth == pytest.approx(250.0, abs=8.0)
