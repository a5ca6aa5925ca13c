"""Logs of twins: their bytes and messages, other references, faults, mean currents alone, a sea that changes."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from replay_kit.config.run import ForecastConfig, MeasurementConfig
from replay_kit.core.errors import ConfigError, ForecastError
from replay_kit.core.geodesy import rotate_to_local, to_local
from replay_kit.core.observation import Observation, PathMean
from replay_kit.forecast import read_changing_truth
from replay_kit.logs import merge, open_log
from replay_kit.measurements import observations
from replay_kit.studies.twins.field import build_field
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.studies.twins.vehicle import EPOCH, EPOCH_NS
from tests import synthetic
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
    assert made.pings.time_ns.size == 40
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
        ({"vehicle": "glider", "interval_s": 601.0}, "whole number"),
        ({"vehicle": "glider", "interval_s": 0.0}, "whole number"),
        ({"interval_s": 1200.0}, "a glider's"),
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


DAY_NS = 86_400 * 10**9


def test_mean_currents_are_the_means_along_their_paths(tmp_path):
    truth = make_truth()
    write_glider(truth, Twin("glider", 40, 0.05, 3), tmp_path / "a.mcap", pings=False)
    found = observed(tmp_path / "a.mcap")
    assert [type(each) for each in found] == [PathMean] * 3
    field, projection = build_field(truth), truth.grid.projection
    for mean in found:
        east, north = to_local(projection, mean.longitude, mean.latitude)
        local = mean.weight @ field.velocity(east, north, mean.depth)
        middle = mean.longitude.mean(), mean.latitude.mean()
        stated = rotate_to_local(projection, *middle, *mean.velocity)
        # the path between fixes is dead-reckoned with one current, and a position comes every ten minutes
        np.testing.assert_allclose(local, stated, atol=0.01)
        assert mean.weight @ mean.depth == pytest.approx(250.0, abs=8.0)


def test_a_sea_that_changes_is_linear_between_its_times():
    early = replace(make_truth(), time_ns=EPOCH_NS)
    late = replace(early, velocity=-2.0 * early.velocity, time_ns=EPOCH_NS + DAY_NS)
    field = build_field(early, late)
    place = np.array([5e3, -2e4]), np.array([1e4, 3e3]), np.array([20.0, 400.0])
    at_first = build_field(early).velocity(*place)
    # two places at two times
    for since, factors in (([0, DAY_NS // 2], [[1.0], [-0.5]]), (DAY_NS, -2.0)):
        found = field.velocity(*place, EPOCH_NS + np.array(since))
        np.testing.assert_allclose(found, at_first * factors, atol=1e-12)
    with pytest.raises(ForecastError, match="goes beyond"):
        field.velocity(*place, EPOCH_NS + DAY_NS + 1)
    with pytest.raises(ForecastError, match="times that grow"):
        build_field(late, early)


@pytest.mark.full
def test_a_mission_through_a_sea_that_changes_measures_it(tmp_path):
    early = replace(make_truth(), time_ns=EPOCH_NS)
    late = replace(early, velocity=0.0 * early.velocity, time_ns=EPOCH_NS + DAY_NS)
    make_twin([early, late], Twin("glider", 14, 0.0, 3, interval_s=3600.0), tmp_path / "a.mcap")
    field = build_field(early)
    found = profiles(observed(tmp_path / "a.mcap"))
    assert [each.time_ns for each in found] == [EPOCH_NS + k * 3600 * 10**9 for k in range(14)]
    for k, each in enumerate(found):
        if each.dive == 0:
            east, north = to_local(early.grid.projection, each.longitude, each.latitude)
            expected = (1.0 - k / 24.0) * field.velocity(east, north, each.depth)
            measured = np.column_stack(
                rotate_to_local(
                    early.grid.projection, each.longitude, each.latitude, *each.velocity.T
                )
            )
            np.testing.assert_allclose(measured, expected, atol=2e-3)
    assert {each.dive for each in found} > {0}
    with pytest.raises(ForecastError, match="goes beyond"):
        make_twin([early, late], Twin("glider", 25, 0.0, 3, interval_s=3600.0), tmp_path / "b.mcap")


def test_a_truth_is_read_at_all_its_leads(tmp_path):
    members = synthetic.dataset(n_members=2)
    leads = members.expand_dims(lead=[0.0, 12.0]).copy(deep=True)
    leads["lead"].attrs["units"] = "hours"
    leads["uo"][1] *= 2.0
    leads.to_netcdf(tmp_path / "leads.nc", engine="h5netcdf")
    first, second = read_changing_truth(f"{tmp_path / 'leads.nc'}#1", ForecastConfig(), EPOCH)
    assert (first.time_ns, second.time_ns) == (EPOCH_NS, EPOCH_NS + DAY_NS // 2)
    assert np.nanmax(np.abs(second.velocity[0, 0])) > 1.5 * np.nanmax(np.abs(first.velocity[0, 0]))
    with pytest.raises(ForecastError, match="remove --lead"):
        read_changing_truth(f"{tmp_path / 'leads.nc'}#1", ForecastConfig(lead=0.0), EPOCH)
    leads.isel(lead=0).to_netcdf(tmp_path / "one.nc", engine="h5netcdf")
    with pytest.raises(ForecastError, match="needs a dimension"):
        read_changing_truth(f"{tmp_path / 'one.nc'}#1", ForecastConfig(), EPOCH)
