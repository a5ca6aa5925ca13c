"""All of the MCAP project's conformance files, and real bags, against the records of the stock library.

| case | asserted |
|---|---|
| 416 conformance files | the messages of the file's records, byte for byte |
| rosbag2 bags, one vehicle's log | those of the file by topic; what cannot be decoded is listed once with its count |
"""

from collections import Counter

from replay_kit.logs import open_log
from tests.fuzz.damage import read_raw, sound_messages
from tests.logs.log_samples import SHARED
from tests.places import needs

pytestmark = needs(SHARED)
MESSAGES = {"OneMessage": 1, "OneSchemalessMessage": 1, "TenMessages": 10}


def test_conformance_files_give_what_their_records_hold():
    files = sorted((SHARED / "mcap-conformance").rglob("*.mcap"))
    assert len(files) == 416
    for file in files:
        said, report = read_raw(file)
        assert said == [message.said for message in sound_messages(file.read_bytes())], file.name
        assert len(said) == MESSAGES.get(file.parent.name, 0), file.name
        assert report.losses == (), file.name


def test_bags_give_what_their_records_hold():
    refused = {}
    for file in [*(SHARED / "rosbag2").glob("*.mcap"), SHARED / "ros2-vehicle" / "demo.mcap"]:
        reader = open_log(file)
        decoded = Counter(message.topic for message in reader.messages())
        report = reader.report()
        assert report.losses == (), file.name
        held = Counter(message.said[0] for message in sound_messages(file.read_bytes()))
        lost = Counter({topic: count for topic, (count, _) in report.undecodable.items()})
        assert decoded + lost == report.read == held, file.name
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
