"""The writer of JSON in MCAP, as the stock reader gives it."""

import base64
import json
import math

import numpy as np
import pytest
from mcap.reader import make_reader

from replay_kit.core.errors import LogError
from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log

START = 1_542_326_400_000_000_000


def _message(payload, schema="some.Schema"):
    return Message(START, "/t", schema, payload, 0, 0)


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
    write_mcap_log(tmp_path / "a.mcap", [_message(payload), _message({"a": 1}, schema="")])
    with (tmp_path / "a.mcap").open("rb") as file:
        one, other = make_reader(file, validate_crcs=True).iter_messages()
    schema, channel, message = one
    assert (schema.name, schema.encoding) == ("some.Schema", "jsonschema")
    assert json.loads(schema.data) == described
    assert (channel.topic, channel.message_encoding) == ("/t", "json")
    assert message.log_time == message.publish_time == START
    plain = {"nan": None, "inf": [None, 1.0], "array": [1.5, None], "pair": [1, 2]}
    plain |= {"bytes": base64.b64encode(b"\x00\xff").decode()}
    assert json.loads(message.data) == payload | plain
    # a message without a schema stays without
    assert other[0] is None


def test_a_payload_without_json_form_is_refused(tmp_path):
    with pytest.raises(LogError, match="/t at"):
        write_mcap_log(tmp_path / "a.mcap", [_message({"a": object()})])
