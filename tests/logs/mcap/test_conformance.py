"""All of the MCAP project's conformance files, and real bags, against the stock reader.

| case | asserted |
|---|---|
| 416 conformance files | the stock reader's messages, byte for byte; all of the file's where the stock reader fails |
| rosbag2 bags, one vehicle's log | the stock reader's messages by topic; those that cannot be decoded are listed once with their count |
"""

from collections import Counter

from mcap.exceptions import McapError
from mcap.reader import make_reader

from replay_kit.logs import open_log
from replay_kit.logs.decode import decoders as mcap_channels
from tests.logs.log_samples import SHARED
from tests.places import needs

pytestmark = needs(SHARED)
MESSAGES = {"OneMessage": 1, "OneSchemalessMessage": 1, "TenMessages": 10}


def stock(file):
    """Return (topic, schema, log time, data) of each message in file order; None where the stock reader fails."""
    with open(file, "rb") as stream:
        try:
            found = list(make_reader(stream).iter_messages(log_time_order=False))
        # it looks up channels and schemas in the summary alone, which need not repeat them
        except (McapError, KeyError):
            return None
    return [
        (channel.topic, schema.name if schema else "", message.log_time, message.data)
        for schema, channel, message in found
    ]


def test_conformance_files_give_what_the_stock_reader_gives(
    monkeypatch,
):
    # their encodings are no words of any decoder, so the bytes themselves are looked at
    monkeypatch.setattr(
        mcap_channels, "channel_decoder", lambda encoding, schema: lambda data: {"data": data}
    )
    files = sorted((SHARED / "mcap-conformance").rglob("*.mcap"))
    assert len(files) == 416
    compared = 0
    for file in files:
        reader = open_log(file)
        ours = [(m.topic, m.schema, m.time_ns, m.payload["data"]) for m in reader.messages()]
        assert len(ours) == MESSAGES.get(file.parent.name, 0), file.name
        assert reader.report().losses == (), file.name
        theirs = stock(file)
        assert theirs is None or ours == theirs, file.name
        compared += theirs is not None
    assert compared > 300


def test_bags_give_what_the_stock_reader_gives():
    refused = {}
    for file in [*(SHARED / "rosbag2").glob("*.mcap"), SHARED / "ros2-vehicle" / "demo.mcap"]:
        reader, theirs = open_log(file), stock(file)
        decoded = Counter(message.topic for message in reader.messages())
        report = reader.report()
        assert report.losses == (), file.name
        assert Counter(topic for topic, *_ in theirs) == report.read, file.name
        lost = Counter({topic: count for topic, (count, _) in report.undecodable.items()})
        assert decoded + lost == report.read, file.name
        for topic, (_, why) in report.undecodable.items():
            refused[file.name.split("__")[-1], topic] = why
    # one service-event schema or made-up encoding does not stop the topics beside it
    services = {key for key in refused if key[1].endswith("_service_event")}
    assert all("---" in refused[key] for key in services)
    assert {name for name, _ in services} == {
        "only_services.mcap",
        "topics_and_services.mcap",
        "bag_with_topics_and_service_events.mcap",
    }
    assert {name for name, _ in refused.keys() - services} == {"wrong_rmw_test_0.mcap"}
