"""The layout of a result: every panel finds its topic, schema and field in the file."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader

from replay_kit.results.layout import layout_of
from tests.command import invoke, succeed

#: Panels and the schemas that they show in Foxglove 2 and Lichtblick 1.
SHOWN = {
    "map": {"foxglove.LocationFix", "foxglove.GeoJSON"},
    "3D": {
        "foxglove.Grid",
        "foxglove.SceneUpdate",
        "foxglove.PosesInFrame",
        "foxglove.FrameTransform",
    },
    "RosOut": {"foxglove.Log"},
    "Plot": {"replay_kit.Innovations", "", "replay_kit.PlanOutcome"},
    "Table": {"replay_kit.Consistency"},
}


#: Fields of a grid of the flow.
GRID = {"u", "v", "speed", "u_standard_error", "v_standard_error"}


@pytest.fixture
def result(run) -> Path:
    return run / "out.mcap"


def named_paths(layout: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the topics that the panels of a layout name, each with the path of a field in its messages; empty for whole messages."""
    named: list[tuple[str, str]] = []
    for config in layout["configById"].values():
        topics = config.get("topics", {}).items()
        named += [(topic, settings.get("colorField", "")) for topic, settings in topics]
        whole = (*config.get("topicColors", {}), config.get("followTopic"))
        named += [(topic, "") for topic in (*whole, config.get("topicToRender")) if topic]
        paths = [path["value"] for path in config.get("paths", ())]
        paths += [config[key] for key in ("topicPath",) if key in config]
        named += [(topic, field) for topic, _, field in (path.partition(".") for path in paths)]
    return named


def held(result: Path):
    """The schemas of a result's topics by name, with their descriptors; its layout; and the span of its messages on ``/tf`` [s]."""
    with result.open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        schemas = {one.topic: summary.schemas[one.schema_id] for one in summary.channels.values()}
        attached = {record.name: record.data for record in reader.iter_attachments()}
        frames = [message.log_time for _, _, message in reader.iter_messages(topics="/tf")]
    return schemas, json.loads(attached["layout.json"]), (frames[-1] - frames[0]) / 1e9


def fields_of(schema) -> set[str]:
    """The names of the fields of a schema's message, read from its descriptors in the file."""
    for file in FileDescriptorSet.FromString(schema.data).file:
        for message in file.message_type:
            if f"{file.package}.{message.name}" == schema.name:
                return {field.name for field in message.field}
    raise AssertionError(schema.name)


def leaves(tree) -> list[str]:
    return [tree] if isinstance(tree, str) else [*leaves(tree["first"]), *leaves(tree["second"])]


def test_every_panel_finds_its_topic_schema_and_field_in_the_result(result):
    schemas, layout, span = held(result)
    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    for name, config in layout["configById"].items():
        kind, named = name.partition("!")[0], named_paths({"configById": {name: config}})
        # no warning was logged and nothing is wrong: that topic alone may be missing
        present = [(topic, field) for topic, field in named if topic != "/log"]
        assert present or kind == "RosOut", name
        for topic, field in present:
            assert schemas[topic].name in SHOWN[kind], (name, topic)
            fields = GRID if kind == "3D" else fields_of(schemas[topic])
            assert field.partition("[")[0] in {"", *fields}, (name, topic, field)
    topics, paths = map(set, zip(*named_paths(layout), strict=True))
    planned = {"/plan/geojson", "/plan/path", "/flow/innovation", "/flow/consistency"}
    assert planned | {"/vehicle/fix", "/log"} <= topics
    assert {"innovation_east[:]", "innovation_std_north[:]", "u_standard_error"} <= paths
    # the vehicle's frame is there through the log
    assert span > 3600.0


def test_the_command_writes_the_attachment_s_layout_for_any_result(result, tmp_path):
    out = tmp_path / "layout.json"
    succeed(f"layout {result} -o {out}")
    assert json.loads(out.read_text()) == held(result)[1]
    refused = invoke(f"layout sample_logs/glider.mcap -o {tmp_path}/no.json")
    assert refused.exit_code == 3
    assert "give a result" in refused.stderr
    # a result without a plan has a map and a scene without one
    named = named_paths(layout_of({"/vehicle/fix", "/flow/grid/5m", "/flow/arrows/5m"}))
    assert not any("/plan/" in topic for topic, _ in named)


def test_the_status_of_a_result_is_of_the_time_that_is_given(result):
    done = succeed(f"status {result} --json - --now 2018-11-17T00:00:00Z")
    assert json.loads(done.stdout)["now"] == "2018-11-17 00:00:00Z"
    assert "Steer" in done.stderr
    wrong = invoke(f"status {result} --now noon")
    assert (wrong.exit_code, "--now: 'noon' is no time" in wrong.stderr) == (2, True)
