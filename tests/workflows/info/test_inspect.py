"""``replay-kit info``: a suggested mapping from the topics that no known kind covers, used again as a configuration."""

import io
import json
from dataclasses import replace

import pytest

from replay_kit.config.run import load_config
from replay_kit.show.text import SafeConsole
from replay_kit.workflows.info.inspect import inspect_logs
from replay_kit.workflows.info.listing import print_info
from tests.command import invoke, run_command
from tests.measurements.carriers import json_mcap
from tests.measurements.samples import fix, ping


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "vendor.mcap"
    known = [
        (k, message.topic, message.schema, message.payload)
        for k, message in enumerate((fix(0), ping(1)))
    ]
    nav = [
        (
            k,
            "/vendor/nav",
            "vendor.Nav",
            {"pos": {"lat": -40.0, "lon": 152.0 + k}, "depth": 5.0 * k},
        )
        for k in range(3)
    ]
    dull = [(9, "/vendor/text", "vendor.Text", {"words": "none"})]
    raw = [
        (
            9,
            "mavlink/1/1/VFR_HUD",
            "mavlink.1.1.VFR_HUD",
            {"header": {}, "message": {"type": "VFR_HUD", "alt": 3.0}},
        )
    ]
    path.write_bytes(json_mcap([*known, *nav, *dull, *raw]))
    return path


def run_info(*arguments):
    done = invoke(["info", *map(str, arguments)])
    return done.exit_code, done


def test_a_suggested_mapping_is_printed_alone(log):
    code, said = run_info(log, "--suggest", "-")
    assert code == 0
    assert said.stdout.startswith("# A first mapping")
    assert 'topic = "/vendor/nav"' in said.stdout
    assert "/adcp" not in said.stdout
    assert "mavlink" not in said.stdout
    assert "Use: ready for replay" in said.stderr


def test_a_suggested_mapping_makes_the_topic_usable(log, tmp_path):
    before = inspect_logs([log], load_config(None))[0]
    assert set(before.unknown) == {"/vendor/nav", "/vendor/text"}
    code, _ = run_info(log, "--suggest", tmp_path / "map.toml")
    assert code == 0
    _, said = run_info(log, "--config", tmp_path / "map.toml", "--json", "-")
    assert json.loads(said.stdout)["logs"][0]["positions"] == before.content.positions + 3


def test_a_depth_averaged_current_is_no_position(tmp_path):
    (tmp_path / "dac.mcap").write_bytes(
        json_mcap(
            [
                (
                    0,
                    "/dac",
                    "replay_kit.DepthAveragedCurrent",
                    {"start_fix": {"lat": 1.0, "lon": 2.0}},
                )
            ]
        )
    )
    found = inspect_logs([tmp_path / "dac.mcap"], load_config(None))[0]
    assert found.unknown == {}
    assert found.not_used == {"/dac": {"depth-averaged current: not a number": 1}}


def test_every_note_of_the_reader_and_what_is_damaged_or_unchecked_is_printed(log):
    found = inspect_logs([log], load_config(None))[0]
    told = {
        "notes": ("the clock was set twice",),
        "undecodable": {"/raw": (7, "no schema")},
        "unchecked": {"chunks": 3},
    }
    text = io.StringIO()
    print_info(
        replace(found, report=replace(found.report, **told)), SafeConsole(file=text, width=200)
    )
    for words in (
        "Note: the clock was set twice",
        "Cannot be decoded: 7 x /raw: no schema",
        "Without a checksum",
    ):
        assert words in text.getvalue()


def test_logs_given_together_are_judged_together(tmp_path):
    place = fix(0)
    fixes = [(10 * k, place.topic, place.schema, place.payload) for k in range(30)]
    pings = [(5 + 10 * k, "/adcp", "replay_kit.AdcpPing", ping(0).payload) for k in range(25)]
    for name, rows in (("places", fixes), ("pings", pings)):
        (tmp_path / f"{name}.mcap").write_bytes(json_mcap(rows))
    done = run_command(tmp_path, "info places.mcap pings.mcap")
    assert "Together: ready for replay" in done.stdout
    assert "25 profiles" in done.stdout
    assert "Missing" not in done.stdout
    assert "ANOTHER_LOG" not in done.stdout
    assert "Next: replay-kit replay places.mcap pings.mcap" in done.stdout
    (tmp_path / "more.mcap").write_bytes(json_mcap(pings[:2]))
    done = run_command(tmp_path, "info more.mcap pings.mcap")
    assert done.stdout.count("Missing for a replay: positions\n") == 1
