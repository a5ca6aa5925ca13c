"""A result is made again bit for bit, and whatever was changed in it is found and named."""

import json
import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from mcap_protobuf.decoder import DecoderFactory

from replay_kit.config.planner import PlannerConfig
from replay_kit.config.run import RunConfig
from replay_kit.core.errors import LogError
from replay_kit.core.plan import Place
from replay_kit.forecast import read_truth
from replay_kit.results import first_difference, read_recorded
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.planning.adapters import planner_of
from replay_kit.workflows.replay.inputs.job import ReplayJob
from replay_kit.workflows.replay.replay import replay
from replay_kit.workflows.verify import _job, verify
from tests import synthetic
from tests.command import invoke, succeed


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A folder with a log, an ensemble, and the result of a replay with a goal."""
    folder = tmp_path_factory.mktemp("run")
    synthetic.write_ocean(folder, 12)
    config = RunConfig(planner=PlannerConfig(kind="glide"))
    make_twin(
        read_truth(str(folder / "truth.nc"), config.forecast),
        Twin("glider", 30, 0.05, 1),
        folder / "glider.mcap",
    )
    job = ReplayJob(
        (folder / "glider.mcap",),
        folder / "ensemble.nc",
        folder / "out.mcap",
        goal=Place(152.3, -39.8, 150.0),
    )
    replay(job, config, planner_of)
    return folder


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
    assert verdict.messages == read_recorded(run / "out.mcap").digests[-1].messages > 90
    assert not verdict.notes
    assert first_difference(run / "out.mcap", run / "out.mcap") is None


@pytest.mark.parametrize(
    ("topic", "field"),
    [
        ("/flow/innovation", "nis[0]"),
        ("/flow/estimate", "x[3]"),
        pytest.param("/plan/controls", "heading_deg", marks=pytest.mark.full),
    ],
)
def test_a_changed_message_is_named_with_its_field(run, tmp_path, topic, field):
    index = index_of(run / "out.mcap", topic)

    def edit(message):
        name, _, number = field.rstrip("]").partition("[")
        if number:
            getattr(message, name)[int(number)] *= 1.0 + 2e-7
        else:
            setattr(message, field, getattr(message, field) * (1.0 + 1e-15) + 1e-300)

    verdict = verdict_on(run, tmp_path, (index, edited(edit)))
    assert (verdict.difference.index, verdict.difference.topic) == (index, topic)
    assert len(verdict.difference.fields) == 1
    assert verdict.difference.fields[0].startswith(f"{field}: ")
    assert verdict.messages == index
    assert not verdict.same


@pytest.mark.full
def test_a_missing_message_and_a_changed_attachment_are_named(run, tmp_path):
    with (run / "out.mcap").open("rb") as file:
        count = sum(1 for _ in make_reader(file).iter_messages(log_time_order=False))
    short = verdict_on(run, tmp_path, (count - 1, lambda schema, data: None))
    assert short.difference.fields == ("only the second has this message",)
    verdict = verdict_on(
        run,
        tmp_path,
        attachment=lambda name, data: data[:-1] if name == "estimate.npz" else data,
    )
    assert verdict.others == ("attachment estimate.npz",)
    assert verdict.difference is None


def test_other_settings_than_recorded_are_found_at_the_first_digest(run, tmp_path):
    def settings(name, data):
        return data.replace(b"velocity_std = 0.09", b"velocity_std = 0.1").replace(
            b"surface_depth = 3.0", b"surface_depth = 200.0"
        )

    verdict = verdict_on(run, tmp_path, attachment=settings)
    assert not verdict.same
    assert verdict.difference.index < read_recorded(verdict.result).digests[1].messages


@pytest.mark.full
def test_a_digest_that_lies_or_is_missing_hides_nothing(run, tmp_path):
    index = index_of(run / "out.mcap", "/plan/controls")

    turned = edited(lambda plan: setattr(plan, "heading_deg", plan.heading_deg + 90.0))
    lying = stating("replay_kit.digest", sha256="0" * 64)
    for metadata in (lying, lambda name, values: None if name == "replay_kit.digest" else values):
        verdict = verdict_on(run, tmp_path, (index, turned), metadata=metadata)
        assert verdict.difference.index == index
        untouched = verdict_on(run, tmp_path, metadata=metadata)
        assert untouched.difference is None
        assert "the digests" in untouched.others


def test_changed_metadata_schemas_and_stamps_are_named(run, tmp_path):
    options = stating("replay_kit.options", modes="7")
    (other,) = verdict_on(run, tmp_path, metadata=options).others
    assert other.startswith("metadata replay_kit.options: modes: 7 | ")
    path = changed(run / "out.mcap", tmp_path / "later.mcap", later_ns=5)
    assert first_difference(run / "out.mcap", path).fields[0].startswith("publish_ns: ")


def test_other_versions_are_said(run, tmp_path):
    older = stating("replay_kit.versions", numpy="1.0", gone="3")
    verdict = verdict_on(run, tmp_path, metadata=older)
    assert verdict.same
    assert any("made with numpy 1.0, here it is" in note for note in verdict.notes)
    assert any("made with gone 3, here it is none" in note for note in verdict.notes)


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
    assert "made again bit for bit" in said.output
    assert json.loads((tmp_path / "verdict.json").read_text())["same"] is True
    index = index_of(run / "out.mcap", "/vehicle/fix")
    north = edited(lambda fix: setattr(fix, "latitude", fix.latitude + 1.0))
    path = changed(run / "out.mcap", tmp_path / "other.mcap", (index, north))
    said = invoke(f"verify {path} --inputs {run}")
    assert said.exit_code == 5
    assert f"message {index} differs: /vehicle/fix" in said.output
    assert "latitude: " in said.output


@pytest.mark.full
def test_a_result_of_contract_version_2_is_verified_by_its_bytes_with_a_note(run, tmp_path):
    """Version 3 renamed fields, so the definitions of the schemas differ and the messages do not."""

    old = changed(
        run / "out.mcap",
        tmp_path / "old.mcap",
        metadata=stating("contract", version="2"),
        definition=lambda data: data.replace(b"gate_threshold", b"gate_formerly_"),
    )
    assert first_difference(run / "out.mcap", old).fields == (
        "schema: the definitions of replay_kit.Innovations differ",
    )
    verdict = verify(old, [run], planner_of)
    assert verdict.same, verdict
    assert verdict.notes == (
        "made with contract version 2, here it is 6: names of fields were not compared",
    )
    damaged = changed(
        old,
        tmp_path / "damaged.mcap",
        message=(index_of(old, "/flow/innovation"), lambda schema, data: data + b"\x08\x01"),
    )
    assert not verify(damaged, [run], planner_of).same


def test_other_forecasts_of_several_files_are_verified_as_they_were_given():
    names = ("against1_1", "against1_2", "against2", "against10")
    recorded = SimpleNamespace(metadata={})
    job = _job(recorded, {name: Path(name) for name in reversed(names)}, Path("out.mcap"))
    assert job.against == ((Path(names[0]), Path(names[1])), (Path(names[2]),), (Path(names[3]),))
