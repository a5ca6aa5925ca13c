"""Topics called by other names."""

from replay_kit.config.run import LogConfig
from replay_kit.logs import open_log
from replay_kit.workflows.convert import convert
from tests.logs.log_samples import json_mcap, one_channel_mcap, tlog

CONFIG = LogConfig(remap={"/a": "/left", "mavlink/1/1/ATTITUDE": "/attitude", "/x": "/y"})


def test_messages_and_counts_take_the_new_name(tmp_path):
    for name, data, expected in (
        ("log.mcap", json_mcap(range(3)), {"/left": 2, "/b": 1}),
        ("log.tlog", b"".join(tlog(3)), {"/attitude": 3}),
    ):
        (tmp_path / name).write_bytes(data)
        reader = open_log(tmp_path / name, 0, CONFIG)
        assert {message.topic for message in reader.messages()} == set(expected)
        assert reader.report().read == expected


def test_what_cannot_be_decoded_takes_the_new_name(tmp_path):
    (tmp_path / "log").write_bytes(one_channel_mcap("cdr", None, [b"1"]))
    reader = open_log(tmp_path / "log", 0, CONFIG)
    assert list(reader.messages()) == []
    assert set(reader.report().undecodable) == {"/y"}


def test_a_copy_takes_the_new_name(tmp_path):
    (tmp_path / "log").write_bytes(json_mcap(range(3)))
    assert convert([tmp_path / "log"], tmp_path / "out.mcap", False, CONFIG).messages == {
        "/left": 2,
        "/b": 1,
    }
