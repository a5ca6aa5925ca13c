import base64
import json
import math

import numpy as np
import pytest
from mcap.reader import make_reader

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs import open_log
from replay_kit.logs.mcap.writer import write_mcap_log

START = 1_542_326_400_000_000_000


def _message(payload, topic="/t", schema="some.Schema", time_ns=START):
    return Message(time_ns, topic, schema, payload, 0, 0)


def test_json_has_null_for_nan_and_base64_for_bytes(tmp_path):
    payload = {
        "nan": math.nan,
        "inf": [math.inf, 1.0],
        "bytes": b"\x00\xff",
        "array": np.array([1.5, np.nan]),
        "pair": (1, 2),
        "big": 2**64 - 1,
        "cells": [[1.0]],
        "part": {"none": None, "is": True},
    }
    part = {"type": "object", "properties": {"is": {"type": "boolean"}}}
    pair = {"type": "array", "items": {"type": "number"}}
    named = {"bytes": {"type": "string"}, "big": {"type": "number"}, "part": part}
    described = {"type": "object", "properties": {**named, "array": pair, "pair": pair}}
    write_mcap_log(tmp_path / "a.mcap", [_message(payload)])
    with (tmp_path / "a.mcap").open("rb") as file:
        ((schema, channel, message),) = make_reader(file, validate_crcs=True).iter_messages()
    assert schema is not None
    assert (schema.name, schema.encoding, json.loads(schema.data)) == (
        "some.Schema",
        "jsonschema",
        described,
    )
    assert (channel.topic, channel.message_encoding, message.log_time, message.publish_time) == (
        "/t",
        "json",
        START,
        START,
    )
    read = json.loads(message.data)
    assert (read["nan"], read["inf"], read["array"], read["pair"], read["big"]) == (
        None,
        [None, 1.0],
        [1.5, None],
        [1, 2],
        2**64 - 1,
    )
    assert base64.b64decode(read["bytes"]) == b"\x00\xff"


def test_a_message_without_a_schema_stays_without(tmp_path):
    write_mcap_log(tmp_path / "a.mcap", [_message({"a": 1}, schema="")])
    with (tmp_path / "a.mcap").open("rb") as file:
        ((schema, _, _),) = make_reader(file).iter_messages()
    assert schema is None


def test_what_was_written_is_read_back_without_loss(tmp_path):
    messages = [_message({"k": k}, f"/{k % 3}", time_ns=START + k) for k in range(50)]
    write_mcap_log(tmp_path / "a.mcap", messages)
    reader = open_log(tmp_path / "a.mcap")
    read, given = (
        [(m.time_ns, m.topic, m.schema, m.payload) for m in source]
        for source in (reader.messages(), messages)
    )
    assert read == given
    assert reader.report().losses == ()


def test_a_payload_without_json_form_is_refused(tmp_path):
    with pytest.raises(LogError, match="/t at"):
        write_mcap_log(tmp_path / "a.mcap", [_message({"a": object()})])
