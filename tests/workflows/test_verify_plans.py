"""Plans are made again from what their results record, and what was changed in them or in their inputs is found and named."""

import json
import shutil

import pytest

from replay_kit.core.errors import LogError
from replay_kit.results import read_recorded
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.planning.record import plan_again, recorded_request
from replay_kit.workflows.verify import verify
from tests.command import invoke, succeed
from tests.planners.flow_samples import uncertain_flow
from tests.workflows.test_verify import changed

AREA = [[152.6, -40.1], [152.61, -40.1], [152.61, -40.09], [152.6, -40.1]]


def again(path, *folders):
    return verify(path, folders, planner_of, plan_again=plan_again)


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    """A folder with an estimate, areas, settings, and the result of a plan with options of each kind."""
    folder = tmp_path_factory.mktemp("mission")
    uncertain_flow().save(folder / "flow.nc")
    areas = {
        "type": "Feature",
        "properties": {"name": "range"},
        "geometry": {"type": "Polygon", "coordinates": [AREA]},
    }
    (folder / "areas.geojson").write_text(json.dumps(areas))
    (folder / "run.toml").write_text("[planner]\nmax_angle = 30.0\nlegs = 3\nseed = 5\n")
    ask = "--start=152.42,-40.0,0 --goal=152.52,-39.96,0 --depth 390 --samples 4"
    more = "--objective time=1,energy=0.01 --start-time 2001-09-09T02:00Z --battery 3"
    files = f"--config {folder}/run.toml --no-go {folder}/areas.geojson -o {folder}/plan.mcap"
    succeed(f"plan {folder}/flow.nc {ask} {more} {files}")
    return folder


def test_a_mission_is_made_again(mission):
    said = succeed(f"verify {mission}/plan.mcap --json -")
    verdict = json.loads(said.stdout)
    assert (verdict["same"], verdict["made"], verdict["notes"]) == (True, [], [])
    assert "plan.mcap: the same values" in said.stderr


def test_a_changed_or_missing_input_is_named(mission, tmp_path):
    for name in ("plan.mcap", "flow.nc"):
        shutil.copy(mission / name, tmp_path)
    with pytest.raises(
        LogError,
        match=r"its input no_go is areas\.geojson with SHA-256 .*there is none; give its folder",
    ):
        again(tmp_path / "plan.mcap")
    (tmp_path / "areas.geojson").write_text((mission / "areas.geojson").read_text() + "\n")
    with pytest.raises(LogError, match=r"found only other contents: .*areas\.geojson"):
        again(tmp_path / "plan.mcap")
    said = invoke(f"verify {tmp_path}/plan.mcap")
    assert said.exit_code == 3


def test_an_altered_leg_is_named_with_both_values(mission, tmp_path):
    def turned(name, values):
        if name != "legs":
            return values
        return values | {"2": json.dumps(json.loads(values["2"]) | {"heading_deg": 90.0})}

    altered = changed(mission / "plan.mcap", tmp_path / "plan.mcap", metadata=turned)
    heading = json.loads(read_recorded(mission / "plan.mcap").metadata["legs"]["2"])["heading_deg"]
    said = invoke(f"verify {altered} --inputs {mission} --json -")
    assert (said.exit_code, json.loads(said.stdout)["findings"]) == (
        5,
        [f"legs: 2.heading_deg: 90.0 | {heading}"],
    )


def test_an_altered_request_gives_another_plan(mission, tmp_path):
    def other(name, values):
        return (
            values | {"request": values["request"].replace("152.52", "152.53")}
            if name == "replay_kit.plan"
            else values
        )

    assert not again(
        changed(mission / "plan.mcap", tmp_path / "plan.mcap", metadata=other), mission
    ).same


def test_no_file_is_read_that_is_none_of_the_inputs(mission):
    record = read_recorded(mission / "plan.mcap").metadata["replay_kit.plan"]
    foreign = json.dumps(
        json.loads(record["request"])
        | {"bathymetry": "/etc/hostname", "others": ["/etc/hostname"], "flows": ["x.nc"]}
    )
    job = recorded_request(
        record | {"request": foreign},
        {"flow0": mission / "flow.nc", "no_go": mission / "areas.geojson"},
    )
    assert (job.flows, job.no_go, job.bathymetry) == (
        (mission / "flow.nc",),
        mission / "areas.geojson",
        None,
    )


def test_a_plan_that_does_not_say_what_was_asked_for_is_refused(mission, tmp_path):
    old = changed(
        mission / "plan.mcap",
        tmp_path / "old.mcap",
        metadata=lambda name, values: None if name == "replay_kit.plan" else values,
    )
    with pytest.raises(
        LogError,
        match=r"old\.mcap: .* a plan of an earlier version, which records no options to make it again from",
    ):
        again(old, mission)
    assert invoke(f"verify {old} --inputs {mission}").exit_code == 3
    for record in (
        {"kind": "mission", "job": "{}"},
        {"request": "{"},
        {"request": '{"start": 3}'},
        {},
    ):
        with pytest.raises(LogError, match="expected the request of a plan"):
            recorded_request(record, {})
