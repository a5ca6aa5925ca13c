"""The messages of a topic: those of the library's reader, in its order."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType, Writer

from replay_kit.results.mcap.topics import OpenResult

TOPICS = ("/a", "/b", "/c")


@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.CHUNK])
def test_messages_come_by_time_then_as_they_lie_in_the_file(tmp_path, index):
    """Times go back over several chunks, and many are equal."""
    path, draw = tmp_path / "log.mcap", np.random.default_rng(0)
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=200, index_types=index)
        writer.start()
        channels = [writer.register_channel(topic, "", 0) for topic in TOPICS]
        # none of the last topic
        for k in range(300):
            time_ns = k // 5 + int(draw.integers(0, 20))
            writer.add_message(
                channels[k % 2], log_time=time_ns, publish_time=time_ns, data=f"{k}".encode()
            )
        writer.finish()
    for topic in TOPICS:
        with path.open("rb") as file:
            expected = [
                (message.log_time, message.data)
                for _, _, message in make_reader(file).iter_messages(topics=topic)
            ]
        assert list(OpenResult(path).messages([topic])) == expected
        assert list(OpenResult(path).newest([topic])) == expected[::-1]
        until = [one for one in expected[::-1] if one[0] <= 30]
        assert list(OpenResult(path).newest([topic], 30)) == until
        assert len(expected) == (0 if topic == "/c" else 150)
    assert list(OpenResult(path).messages(["/unknown"])) == []
