"""MCAP encodings: JSON and protobuf payloads as plain dicts; what fits no decoder is counted with a reason."""

import math

import pytest

from replay_kit.config.run import LogConfig
from tests.logs.log_samples import one_channel_mcap
from tests.logs.log_samples import read_log as read


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('{"a": NaN, "b": inf, "c": -inf}', [math.nan, math.inf, -math.inf]),
        ('{"a": nan, "b": Infinity, "c": -Infinity}', [math.nan, math.inf, -math.inf]),
        ('{"a": NaN, "b": "\\" inf NaN", "c": [inf]}', [math.nan, '" inf NaN', [math.inf]]),
    ],
)
def test_bare_numbers_of_json(tmp_path, text, expected):
    ((message,), _) = read(tmp_path, one_channel_mcap("json", None, [text.encode()]))
    assert repr(message.payload) == repr(dict(zip("abc", expected, strict=True)))


@pytest.mark.parametrize(
    "data", [b"", b"[1]", b"7", b"{", b'{"a": infinite}', b"\xff\xfe", b"[" * 100_000]
)
def test_no_json_object(tmp_path, data):
    messages, report = read(
        tmp_path, one_channel_mcap("json", None, [b'{"ok": 1}', data, b'{"ok": 2}'])
    )
    assert [m.payload["ok"] for m in messages] == [1, 2]
    assert report.read == {"/x": 3}
    assert report.undecodable["/x"][0] == 1


@pytest.mark.parametrize(
    ("encoding", "schema", "reason"),
    [
        ("cbor", None, "has none"),
        ("wrong_format", ("a/msg/B", "ros2msg", b"float64 x"), "not known"),
        ("cdr", ("a/msg/B", "ros2msg", b"float64 x\n---\nfloat64 y"), "cannot be parsed"),
        ("cdr", ("a/msg/B", "ros2msg", b"missing_msgs/Thing x"), "definition not found"),
        ("cdr", ("a/msg/B", "ros2msg", b"\xff"), "cannot be parsed"),
        ("protobuf", ("a.B", "protobuf", b"not a descriptor"), "cannot be parsed"),
        ("cdr", ("a/msg/B", "ros2idl", b"module a { };"), "record in ros2msg"),
        ("protobuf", ("a.B", "protobuf", b""), "cannot be parsed"),
    ],
)
def test_the_reason_is_kept_and_nothing_printed(tmp_path, capsys, encoding, schema, reason):
    data = one_channel_mcap(encoding, schema, [b"\0\1\0\0" + bytes(8)] * 2)
    messages, report = read(tmp_path, data, LogConfig(remap={"/x": "/y"}))
    assert messages == []
    ((topic, (count, why)),) = report.undecodable.items()
    assert (topic, count) == ("/y", 2)
    assert reason in why
    assert capsys.readouterr() == ("", "")
