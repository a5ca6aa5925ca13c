"""Several vehicles with one estimate: the same whatever the order of their logs, each with its own checks, plans and part of the result."""

import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import ReplayKitError
from replay_kit.core.observation import PathMean
from replay_kit.forecast import read_truth
from replay_kit.logs import merge, open_log
from replay_kit.logs.mcap.writer import write_mcap_log
from replay_kit.workflows.replay.inputs.forecast import build
from replay_kit.workflows.replay.inputs.job import ReplayJob, Vehicle, forecasts_of
from replay_kit.workflows.replay.replay import replay
from tests.arrays import write_array
from tests.command import invoke, succeed
from tests.faulty import Faults
from tests.measurements.samples import events_of
from tests.places import SAMPLES
from tests.workflows.replay.given import moved
from tests.workflows.replay.interrupted import goes_on, often

ENSEMBLE = SAMPLES / "ensemble.nc"
TOML = """
forecast.levels = [5, 150, 500]
time.scale = "static"
measurements.flight_bias = false
planner.samples = 3
[estimator]
modes = 6
sample_share = 0.5
shift_distance = 0.0
"""
SETTINGS = tomllib.loads(TOML)
CONFIG = RunConfig(**SETTINGS)
POSITIONS = ("/vehicle/fix", "/vehicle/position", "/dac")
GOAL = "152.4,-40.1,100"
# what is of the command or of a run of it alone
OF_A_RUN = {"format_version": 0, "seconds": 0}


@pytest.fixture(scope="module")
def truth():
    return read_truth(str(SAMPLES / "truth.nc"), CONFIG.forecast)


@pytest.fixture(scope="module")
def logs(tmp_path_factory, truth):
    return write_array(tmp_path_factory.mktemp("logs"), truth, 3, pings=24, late_s=600)


@pytest.fixture(scope="module")
def line(logs, tmp_path_factory):
    """A replay of the three, and the file of its result."""
    folder = tmp_path_factory.mktemp("array")
    (folder / "run.toml").write_text(TOML)
    # no shell expands a pattern behind a name
    words = " ".join(f"--as {name}={path.parent}/{name}*.mcap" for name, path in logs.items())
    files = f"--ensemble {ENSEMBLE} --config {folder}/run.toml -o {folder}/array.mcap"
    return f"replay {words} {files}", folder / "array.mcap"


@pytest.fixture(scope="module")
def answer(line):
    return json.loads(succeed(f"{line[0]} --goal sg2={GOAL} --goal sg3={GOAL} --json -").stdout)


@pytest.fixture
def result(line, answer):
    return rk.open_result(line[1])


def job_of(logs, out: Path, **more) -> ReplayJob:
    vehicles = tuple(Vehicle(name, (path,)) for name, path in logs.items())
    return ReplayJob(tuple(logs.values()), ENSEMBLE, out, vehicles=vehicles, **more)


def test_the_estimate_is_that_of_one_filter_given_all_mean_currents_in_order_of_time(
    tmp_path, truth
):
    logs = write_array(tmp_path, truth, 3, pings=50, dac_only=True, late_s=1500)
    job = job_of(logs, tmp_path / "out.mcap")
    _, flow = replay(job, CONFIG)
    means = [
        one
        for path in logs.values()
        for events in events_of(merge([open_log(path)], 5.0), CONFIG.measurements)
        for one in events
        if isinstance(one, PathMean)
    ]
    ordered = sorted(means, key=lambda mean: mean.time_ns)
    assert means != ordered
    assert len(means) > 6
    estimator = build(forecasts_of(job, CONFIG), CONFIG, None)
    state = estimator.initial()
    for mean in ordered:
        state, _ = estimator.assimilate(state, [mean])
    expected = estimator.flow(state)
    east, north = flow.grid.east[::4, ::4].ravel(), flow.grid.north[::4, ::4].ravel()
    for depth in (5.0, 300.0):
        at = east, north, np.full(east.size, depth)
        for name in ("velocity", "standard_error"):
            pair = (getattr(one, name)(*at) for one in (flow, expected))
            np.testing.assert_allclose(*pair, atol=1e-10)


def test_a_result_opened_again_has_the_outcome_of_the_run_and_of_each_vehicle(answer, result, logs):
    vehicles, alone = result.vehicles, rk.replay(logs["sg1"], ENSEMBLE, settings=SETTINGS)
    assert list(vehicles) == list(answer["vehicles"]) == list(logs)
    for said, opened in (
        (answer, result),
        *((answer["vehicles"][name], vehicles[name]) for name in logs),
    ):
        kept = json.loads(json.dumps(opened.outcome.to_json()))
        assert {**said, **OF_A_RUN} == {**kept, **OF_A_RUN}
    # what is one vehicle's is as if it were alone, and the estimate is of all
    part = vehicles["sg1"]
    assert part.fixes.equals(alone.fixes)
    assert part.outcome.messages == alone.outcome.messages
    assert len(part.observations) == len(alone.observations)
    assert len(result.observations) == 3 * len(part.observations)
    assert set(result.fixes["vehicle"]) == set(logs)
    used = [one.outcome.observations["used"] for one in vehicles.values()]
    assert result.outcome.observations["used"] == sum(used)
    # each last plan begins where and when its own vehicle was last
    assert part.outcome.plan is None
    last = [vehicles[name] for name in ("sg2", "sg3")]
    assert [one.outcome.plan["goal"] for one in last] == [[152.4, -40.1, 100.0]] * 2
    assert len({one.fixes.index[-1] for one in last}) == 2
    assert [one.plans.index[-1] for one in last] == [one.fixes.index[-1] for one in last]


def test_a_vehicle_whose_sources_contradict_each_other_is_left_out(tmp_path, truth):
    logs = write_array(tmp_path, truth, 2, pings=100, faults={1: Faults(heading_bias_deg=90.0)})
    messages = list(open_log(logs["sg2"]).messages())
    for ping in (one.payload for one in messages if one.topic == "/adcp"):
        for cell in ping["velocity"]:
            if None not in cell[:2]:
                cell[:2] = cell[0] - 0.2, cell[1] + 0.2
    write_mcap_log(logs["sg2"], messages)
    with pytest.warns(UserWarning, match="sg2: two sources of the current contradict"):
        found = rk.replay(logs, ENSEMBLE, settings=SETTINGS)
    expected = rk.replay({"sg1": logs["sg1"]}, ENSEMBLE, settings=SETTINGS)
    assert found.estimate.latent == pytest.approx(expected.estimate.latent, abs=1e-9)
    vehicles = found.outcome.vehicles
    assert [len(vehicles[name].consistency) > 0 for name in logs] == [False, True]
    assert vehicles["sg2"].observations["used"] == 0
    assert found.outcome.observations["used"] == expected.outcome.observations["used"]


def positionless(logs, folder):
    return {
        name: moved(path, folder / f"{name}.mcap", without=POSITIONS) for name, path in logs.items()
    }


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda logs, _: {"sg4": logs["sg1"]}, "of sg4: identical to .* of sg1"),
        (lambda logs, _: {"flow": logs["sg1"]}, "vehicle 'flow': expected a name"),
        (lambda logs, _: {"sg4": "no.mcap"}, "no.mcap of sg4: file not found"),
        (
            lambda logs, tmp: {"sg2": moved(logs["sg2"], tmp / "b.mcap", 2e9)},
            "sg2: begins at 20.* different years",
        ),
        (
            lambda logs, tmp: {"sg2": moved(logs["sg2"], tmp / "c.mcap", degrees=9.0)},
            "sg2: was at .* outside the region of the forecast",
        ),
        (positionless, "no vehicle's logs hold any"),
        (
            lambda logs, _: {"sg1": [logs["sg1"], logs.pop("sg2")]},
            "two tracks that no one vehicle can join: .*sg1.mcap and .*sg2.mcap",
        ),
    ],
)
def test_vehicles_that_share_no_estimate_are_refused_by_name(logs, tmp_path, change, message):
    logs = dict(logs)
    more = change(logs, tmp_path)
    with pytest.raises(ReplayKitError, match=message):
        rk.replay(logs | more, ENSEMBLE, settings=SETTINGS)


def test_a_vehicle_without_a_fix_is_named(logs, tmp_path):
    blind = moved(logs["sg2"], tmp_path / "blind.mcap", without=POSITIONS)
    with pytest.warns(UserWarning, match="sg2: no position"):
        found = rk.replay(logs | {"sg2": blind}, ENSEMBLE, settings=SETTINGS)
    assert list(found.outcome.vehicles) == ["sg1", "sg3"]
    (why,) = found.outcome.verdict.reasons
    assert why == f"sg2: {found.outcome.unused['sg2']}"
    assert found.outcome.exit_code == 4


def planned(result, more):
    return json.loads(succeed(f"plan {result.path} --samples 0 --json - {more}").stdout)


def test_a_result_of_several_is_planned_for_each_with_a_goal_as_flown(result, tmp_path):
    vehicles = planned(result, f"-o {tmp_path}/plan.mcap")["vehicles"]
    assert list(vehicles) == ["sg2", "sg3"]
    for name, made in vehicles.items():
        fix = result.vehicles[name].fixes.iloc[-1]
        plan = rk.open_result(tmp_path / f"plan-{name}.mcap").plans.iloc[-1]
        for axis in ("longitude", "latitude"):
            assert plan[f"start_{axis}"] == fix[axis]
        assert f"it begins at {fix.name:%Y-%m-%d %H:%M:%S}Z" in made["notes"][0]
        assert "; as flown: " in made["message"]
        assert "dives: speed" in str(made["notes"])
    # a goal says which is planned
    assert "; as flown: " in planned(result, f"--goal sg1={GOAL}")["message"]


def test_names_that_no_vehicle_has_are_refused(line, result):
    plan = f"plan {result.path}"
    for refused, words in (
        (f"{plan} --goal=sg9={GOAL}", "--goal: expected NAME= of sg1, sg2, sg3, got sg9"),
        (f"{plan} --start={GOAL}", f"--start: expected --glider NAME={GOAL} with one of sg1, sg2"),
        (f"{line[0]} --overwrite --goal sg9={GOAL}", "expected the name of a vehicle"),
    ):
        done = invoke(refused)
        assert (done.exit_code, words in str(done.exception)) == (2, True), done.output


def test_a_status_shows_a_table_then_each_vehicle_and_its_page_links_them(result, tmp_path):
    out, status, page = (tmp_path / f"array.{name}" for name in ("mcap", "json", "html"))
    shutil.copy(result.path, out)
    shown = succeed(f"status {out} --json {status} --html {page}").stdout
    assert shown.startswith("Vehicles")
    assert shown.index("\nsg1, ") < shown.index("\nsg3, ")
    assert list(json.loads(status.read_text())["vehicles"]) == ["sg1", "sg2", "sg3"]
    assert all(name in page.read_text() for name in ("sg1", "sg2", "sg3"))


@pytest.mark.full
def test_commands_show_each_vehicle(result, tmp_path):
    out, areas = tmp_path / "array.mcap", tmp_path / "array.geojson"
    shutil.copy(result.path, out)
    succeed(f"report {out}")
    page = (tmp_path / "array.html").read_text()
    assert all(f'href="array.sg{k}.html"' in page for k in (1, 2, 3))
    for name, own in result.outcome.vehicles.items():
        used = own.observations["used"]
        assert f'<data data-key="vehicles.{name}.observations.used" value="{used}">' in page
    assert (tmp_path / "array.sg2.html").stat().st_size > 100_000
    refused = invoke(f"plot {out} dac -o {tmp_path / 'd.png'}")
    assert "sg1, sg2, sg3" in str(refused.exception)
    invoke(f"export {out} -o {areas}")
    names = [one["properties"]["name"] for one in json.loads(areas.read_text())["features"]]
    tracks = [name for name in names if "track" in name]
    assert tracks == ["sg1 track", "sg2 track", "sg3 track"]


@pytest.mark.full
def test_an_interrupted_replay_goes_on_to_the_same_bytes(logs, tmp_path):
    goes_on(job_of(logs, tmp_path / "out.mcap"), often(CONFIG), 120)
