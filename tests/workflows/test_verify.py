"""A result is made again, and whatever value differs between two results is found and named."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from replay_kit import open_result
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import LogError
from replay_kit.results import difference
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.verify import _job, verify
from tests.command import invoke, succeed
from tests.workflows.replay.interrupted import QUICK


def changed(
    source: Path,
    target: Path,
    message=None,
    metadata=lambda name, values: values,
    attachment=lambda name, data: data,
    definition=lambda data: data,
    later_ns=0,
) -> Path:
    """A copy of a result, with the data of its n-th message, its metadata or attachments changed."""
    number, change = message or (-1, None)
    with source.open("rb") as file, target.open("wb") as out:
        reader, writer = make_reader(file), Writer(out)
        writer.start()
        ids = {}
        for record in reader.iter_attachments():
            data = attachment(record.name, record.data)
            writer.add_attachment(
                record.create_time, record.log_time, record.name, record.media_type, data
            )
        for record in reader.iter_metadata():
            if (values := metadata(record.name, dict(record.metadata))) is not None:
                writer.add_metadata(record.name, values)
        for index, (schema, channel, record) in enumerate(
            reader.iter_messages(log_time_order=False)
        ):
            if channel.id not in ids:
                schema_id = writer.register_schema(
                    schema.name, schema.encoding, definition(schema.data)
                )
                ids[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, schema_id
                )
            data = change(schema, record.data) if index == number else record.data
            if data is not None:
                writer.add_message(
                    ids[channel.id],
                    record.log_time,
                    data,
                    record.publish_time + later_ns,
                    record.sequence,
                )
        writer.finish()
    return target


def edited(edit):
    """A change of a message by a function of it."""

    def change(schema, data):
        message = DecoderFactory().decoder_for("protobuf", schema)(data)
        edit(message)
        return message.SerializeToString()

    return change


def stating(record, **more):
    """A change of a metadata record."""
    return lambda name, values: values | more if name == record else values


def index_of(path: Path, topic: str) -> int:
    with path.open("rb") as file:
        topics = [
            channel.topic for _, channel, _ in make_reader(file).iter_messages(log_time_order=False)
        ]
    return len(topics) - 1 - topics[::-1].index(topic)


def verdict_on(run, tmp_path, message=None, **changes):
    """The verdict on a copy of the result that was changed."""
    path = changed(run / "out.mcap", tmp_path / "other.mcap", message, **changes)
    return verify(path, [run], planner_of)


def test_a_result_is_made_again(run):
    verdict = verify(run / "out.mcap", [], planner_of)
    assert verdict.same
    assert not verdict.notes
    assert str(verdict.difference) == "the same values"


@pytest.mark.parametrize(
    ("topic", "field", "table"),
    [
        ("/flow/innovation", "nis[0]", "observations"),
        ("/vehicle/fix", "latitude", "fixes"),
        pytest.param("/plan/controls", "heading_deg", "plans", marks=pytest.mark.full),
    ],
)
def test_a_value_that_differs_is_named_with_its_table_and_size(run, tmp_path, topic, field, table):
    name, _, number = field.rstrip("]").partition("[")

    def by(share):
        def edit(message):
            if number:
                getattr(message, name)[int(number)] *= 1.0 + share
            else:
                setattr(message, name, getattr(message, name) * (1.0 + share))

        result, other = run / "out.mcap", tmp_path / "other.mcap"
        # a replay gives the same values, as the test above says
        return difference(result, changed(result, other, (index_of(result, topic), edited(edit))))

    (found,) = by(1e-6).tables
    assert (found.name, {*found.columns}) == (table, {name})
    # the last bits of a number are no difference
    assert topic == "/flow/innovation" or by(1e-12).same


def test_other_settings_than_recorded_are_found(run, tmp_path):
    def settings(name, data):
        return data.replace(b"surface_depth = 3.0", b"surface_depth = 200.0")

    found = verdict_on(run, tmp_path, attachment=settings).difference
    assert not found.same
    assert {one.name for one in found.tables} >= {"observations", "innovations"}
    assert len(found.estimate) > 2
    assert all(one.largest >= one.rms > 0.0 for one in found.estimate)


def test_other_versions_are_said(run, tmp_path):
    older = stating("replay_kit.versions", numpy="1.0", gone="3")
    verdict = verdict_on(run, tmp_path, metadata=older)
    assert verdict.same
    assert any("made with numpy 1.0, here it is" in note for note in verdict.notes)
    assert any("made with gone 3, here it is none" in note for note in verdict.notes)


def test_two_results_are_compared_by_their_values_and_settings(run, tmp_path):
    job = ReplayJob((run / "glider.mcap",), run / "ensemble.nc", tmp_path / "b.mcap")
    replay(job, RunConfig(estimator=QUICK | {"modes": 5}))
    found = difference(run / "out.mcap", tmp_path / "b.mcap")
    assert "settings.estimator.modes: 6 | 5" in found.made
    assert [one.depth for one in found.estimate] == open_result(
        tmp_path / "b.mcap"
    ).estimate.levels.tolist()
    assert {one.name: one.rows for one in found.tables}["plans"] == (1, 0)
    done = invoke(f"compare {run}/out.mcap {tmp_path}/b.mcap --json {tmp_path}/c.json")
    assert done.exit_code == 5
    assert json.loads((tmp_path / "c.json").read_text())["same"] is False
    assert succeed(f"compare {run}/out.mcap {run}/out.mcap").output == "the same values\n"
    later = replace(job, out=tmp_path / "d.mcap")
    replay(later, RunConfig(estimator=QUICK, forecast={"levels": (5.0, 150.0, 300.0)}))
    said = invoke(f"compare {tmp_path}/b.mcap {tmp_path}/d.mcap")
    assert said.exit_code == 3
    assert "expected estimates of one grid" in said.output


def test_inputs_are_known_by_their_content(run, tmp_path):
    shutil.copy(run / "out.mcap", tmp_path / "out.mcap")
    with pytest.raises(
        LogError, match=r"log0 is glider\.mcap with SHA-256 .*there is none.*--inputs"
    ):
        verify(tmp_path / "out.mcap", [], planner_of)
    shutil.copy(run / "ensemble.nc", tmp_path / "ensemble.nc")
    (tmp_path / "glider.mcap").write_bytes((run / "glider.mcap").read_bytes() + b"x")
    with pytest.raises(LogError, match="found only other contents"):
        verify(tmp_path / "out.mcap", [], planner_of)
    with pytest.raises(
        LogError,
        match=r"glider\.mcap: expected a whole result of replay-kit replay or plan, but it has no config\.toml; give the file of --out",
    ):
        verify(run / "glider.mcap", [run], planner_of)


def test_the_command_says_it_and_ends_with_0_or_5(run, tmp_path):
    said = succeed(f"verify {run}/out.mcap --json {tmp_path}/verdict.json")
    assert said.output == f"{run}/out.mcap: the same values\n"
    assert json.loads((tmp_path / "verdict.json").read_text())["same"] is True
    index = index_of(run / "out.mcap", "/vehicle/fix")
    north = edited(lambda fix: setattr(fix, "latitude", fix.latitude + 1.0))
    path = changed(run / "out.mcap", tmp_path / "other.mcap", (index, north))
    said = invoke(f"verify {path} --inputs {run}")
    assert said.exit_code == 5
    assert "table fixes: latitude differs by 1" in said.output


def test_other_forecasts_of_several_files_are_verified_as_they_were_given():
    names = ("against1_1", "against1_2", "against2", "against10")
    recorded = SimpleNamespace(metadata={})
    job = _job(recorded, {name: Path(name) for name in reversed(names)}, Path("out.mcap"))
    assert job.against == ((Path(names[0]), Path(names[1])), (Path(names[2]),), (Path(names[3]),))
