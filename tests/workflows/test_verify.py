"""Results and plans are made again, and whatever value differs, of them or of their inputs, is found and named."""

import json
import shutil
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from replay_kit import open_result
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import LogError
from replay_kit.results import difference, read_recorded
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.planning.record import plan_again, recorded_request
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.verify import verify
from tests.command import invoke, succeed
from tests.planners.flow_samples import uncertain_flow
from tests.workflows.replay.interrupted import QUICK, job_in


def changed(source: Path, target: Path, topic=None, edit=None, metadata=None, config=bytes) -> Path:
    """A copy of a result with the last message of a topic, its metadata or its configuration changed."""
    with source.open("rb") as file, target.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        writer.start()
        for record in reader.iter_attachments():
            data = config(record.data) if record.name == "config.toml" else record.data
            times = record.create_time, record.log_time
            writer.add_attachment(*times, record.name, record.media_type, data)
        for record in reader.iter_metadata():
            held = dict(record.metadata)
            if (held := metadata(record.name, held) if metadata else held) is not None:
                writer.add_metadata(record.name, held)
        ids, messages = {}, list(reader.iter_messages(log_time_order=False))
        last = max((k for k, (_, one, _) in enumerate(messages) if one.topic == topic), default=-1)
        for k, (schema, channel, record) in enumerate(messages):
            if channel.id not in ids:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                kind = channel.message_encoding
                ids[channel.id] = writer.register_channel(channel.topic, kind, number)
            data = record.data
            if k == last:
                message = DecoderFactory().decoder_for("protobuf", schema)(data)
                edit(message)
                data = message.SerializeToString()
            times = record.log_time, data, record.publish_time, record.sequence
            writer.add_message(ids[channel.id], *times)
        writer.finish()
    return target


def again(path, *folders):
    return verify(path, folders, planner_of, plan_again=plan_again)


@pytest.mark.parametrize(
    ("topic", "field", "table"),
    [
        ("/flow/innovation", "nis", "observations"),
        ("/vehicle/fix", "latitude", "fixes"),
        pytest.param("/plan/controls", "heading_deg", "plans", marks=pytest.mark.full),
    ],
)
def test_a_value_that_differs_is_named_with_its_table_and_size(run, tmp_path, topic, field, table):
    def by(share):
        def edit(message):
            if field == "nis":
                message.nis[0] *= 1.0 + share
            else:
                setattr(message, field, getattr(message, field) * (1.0 + share))

        result = run / "out.mcap"
        return difference(result, changed(result, tmp_path / "other.mcap", topic, edit))

    (found,) = by(1e-6).tables
    assert (found.name, {*found.columns}) == (table, {field})
    # the last bits of a number are no difference
    assert field == "nis" or by(1e-12).same


def test_a_value_that_one_of_them_lacks_is_no_number(run, tmp_path):
    def lack(message):
        message.nis[0] = float("nan")

    other = changed(run / "out.mcap", tmp_path / "other.mcap", "/flow/innovation", lack)
    said = str(difference(run / "out.mcap", other))
    assert said == "table observations: nis has values that one of them lacks"


def test_other_settings_and_versions_than_recorded_are_found(run, tmp_path):
    path = changed(
        run / "out.mcap",
        tmp_path / "other.mcap",
        metadata=lambda name, held: (
            held | {"numpy": "1.0", "gone": "3"} if name == "replay_kit.versions" else held
        ),
        config=lambda data: data.replace(b"surface_depth = 3.0", b"surface_depth = 200.0"),
    )
    found = again(path, run)
    assert not found.same
    assert {one.name for one in found.tables} >= {"observations", "innovations"}
    assert all(one.largest >= one.rms > 0.0 for one in found.estimate)
    versions = [text.split(" | ")[0] for text in found.made if "versions" in text]
    assert versions == ["replay_kit.versions.gone: 3", "replay_kit.versions.numpy: 1.0"]


def test_two_results_are_compared_by_their_values_and_settings(run, tmp_path):
    other, levels = tmp_path / "b.mcap", tmp_path / "c.mcap"
    replay(job_in(run, other), RunConfig(estimator=QUICK | {"modes": 5}))
    found = difference(run / "out.mcap", other)
    assert "settings.estimator.modes: 6 | 5" in found.made
    assert [one.depth for one in found.estimate] == open_result(other).estimate.levels.tolist()
    assert {one.name: one.rows for one in found.tables}["plans"] == (1, 0)
    done = invoke(f"compare {run}/out.mcap {other} --json -")
    assert (done.exit_code, json.loads(done.stdout)["same"]) == (5, False)
    assert succeed(f"compare {run}/out.mcap {run}/out.mcap").output == "the same values\n"
    replay(
        job_in(run, levels), RunConfig(estimator=QUICK, forecast={"levels": (5.0, 150.0, 300.0)})
    )
    said = invoke(f"compare {other} {levels}")
    assert (said.exit_code, "expected estimates of one grid" in said.output) == (3, True)


def test_inputs_are_known_by_their_content(run, tmp_path):
    path = shutil.copy(run / "out.mcap", tmp_path)
    with pytest.raises(LogError, match=r"log0 is glider\.mcap with SHA-256 .*none.*--inputs"):
        again(Path(path))
    shutil.copy(run / "ensemble.nc", tmp_path)
    (tmp_path / "glider.mcap").write_bytes((run / "glider.mcap").read_bytes() + b"x")
    with pytest.raises(LogError, match="found only other contents"):
        again(Path(path))
    with pytest.raises(LogError, match=r"glider\.mcap: expected a whole result.*no config\.toml"):
        again(run / "glider.mcap", run)


def test_the_command_says_it_and_ends_with_0_or_5(run, tmp_path):
    said = succeed(f"verify {run}/out.mcap --json {tmp_path}/verdict.json")
    assert said.output == f"{run}/out.mcap: the same values\n"
    verdict = json.loads((tmp_path / "verdict.json").read_text())
    assert (verdict["same"], verdict["notes"]) == (True, [])

    def north(fix):
        fix.latitude += 1.0

    path = changed(run / "out.mcap", tmp_path / "other.mcap", "/vehicle/fix", north)
    said = invoke(f"verify {path} --inputs {run}")
    assert said.exit_code == 5
    assert "table fixes: latitude differs by 1" in said.output


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    """A folder with an estimate, areas, settings, and the result of a plan with options of each kind."""
    folder = tmp_path_factory.mktemp("mission")
    uncertain_flow().save(folder / "flow.nc")
    ring = [[152.6, -40.1], [152.61, -40.1], [152.61, -40.09], [152.6, -40.1]]
    areas = {"type": "Polygon", "coordinates": [ring]}
    (folder / "areas.geojson").write_text(json.dumps(areas))
    (folder / "run.toml").write_text("[planner]\nmax_angle = 30.0\nlegs = 3\nseed = 5\n")
    ask = "--start=152.42,-40.0,0 --goal=152.52,-39.96,0 --depth 390 --samples 4"
    more = "--objective time=1,energy=0.01 --start-time 2001-09-09T02:00Z --battery 3"
    files = f"--config {folder}/run.toml --no-go {folder}/areas.geojson -o {folder}/plan.mcap"
    succeed(f"plan {folder}/flow.nc {ask} {more} {files}")
    return folder


def test_a_mission_is_made_again_and_an_altered_leg_named_with_both_values(mission, tmp_path):
    verdict = json.loads(succeed(f"verify {mission}/plan.mcap --json -").stdout)
    assert (verdict["same"], verdict["made"], verdict["notes"]) == (True, [], [])

    def leg(held):
        return json.loads(held["2"])

    def turned(name, held):
        return (
            held | {"2": json.dumps(leg(held) | {"heading_deg": 90.0})} if name == "legs" else held
        )

    altered = changed(mission / "plan.mcap", tmp_path / "plan.mcap", metadata=turned)
    heading = leg(read_recorded(mission / "plan.mcap").metadata["legs"])["heading_deg"]
    said = invoke(f"verify {altered} --inputs {mission} --json -")
    assert said.exit_code == 5
    assert json.loads(said.stdout)["findings"] == [f"legs: 2.heading_deg: 90.0 | {heading}"]


def test_an_altered_request_gives_another_plan_and_a_missing_one_none(mission, tmp_path):
    def request(made):
        return changed(
            mission / "plan.mcap",
            tmp_path / "plan.mcap",
            metadata=lambda name, held: made(held) if name == "replay_kit.plan" else held,
        )

    other = request(lambda held: held | {"request": held["request"].replace("152.52", "152.53")})
    assert not again(other, mission).same
    old = request(lambda held: None)
    with pytest.raises(LogError, match=r"plan\.mcap: .* a plan of an earlier version") as error:
        again(old, mission)
    assert error.value.exit_code == 3
    wrong = {"request": "{"}, {"request": '{"start": 3}'}, {}
    for record in ({"kind": "mission", "job": "{}"}, *wrong):
        with pytest.raises(LogError, match="expected the request of a plan"):
            recorded_request(record, {})


def test_no_input_of_a_plan_is_another_file_than_it_was(mission, tmp_path):
    for name in ("plan.mcap", "flow.nc"):
        shutil.copy(mission / name, tmp_path)
    with pytest.raises(LogError, match=r"no_go is areas\.geojson with SHA-256 .*there is none"):
        again(tmp_path / "plan.mcap")
    (tmp_path / "areas.geojson").write_text((mission / "areas.geojson").read_text() + "\n")
    with pytest.raises(LogError, match=r"found only other contents: .*areas\.geojson"):
        again(tmp_path / "plan.mcap")
    record = read_recorded(mission / "plan.mcap").metadata["replay_kit.plan"]
    foreign = {"bathymetry": "/etc/hostname", "others": ["/etc/hostname"], "flows": ["x.nc"]}
    request = json.dumps(json.loads(record["request"]) | foreign)
    held = {"flow0": mission / "flow.nc", "no_go": mission / "areas.geojson"}
    job = recorded_request(record | {"request": request}, held)
    assert (job.flows, job.no_go, job.bathymetry) == ((held["flow0"],), held["no_go"], None)
