"""Names that would drive a terminal: shown with their controls spelt out, by every command that prints them."""

import json
import re
import shutil
from pathlib import Path

import h5py
import pytest
from rich.table import Table

from replay_kit.cli.console import console_beside
from replay_kit.core.message import Message
from replay_kit.logs.mcap.writer import write_mcap_log
from tests.command import Outcome, invoke
from tests.places import SAMPLES

# Clears the screen, begins a line that looks like one of ours, rings, joins and breaks lines, turns the direction of writing, is a style of
# rich and a picture; and letters of other scripts, which stay.
EVIL = "x\x1b[2J\nreplay-kit: all is well\x07\r\t\x80\x9f\u200e\u2028\u202e\u2069[red]:bug: \u00b5\u200d\u2010\u65e5"
SHOWN = "x\\x1b[2J\\nreplay-kit: all is well\\x07\\r\\t\\x80\\x9f\\u200e\\u2028\\u202e\\u2069[red]:bug: \u00b5\u200d\u2010\u65e5"


def check(outcome: Outcome, code: int) -> str:
    """Return what a command printed, after the checks that no name was obeyed."""
    said = outcome.output
    assert outcome.exit_code == code, said
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u200e\u2028\u202e\u2069]", said)
    assert "\nreplay-kit: all is well" not in said
    assert "\\x1b[2J" in said
    return said


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A log, an ensemble and a result of which all names are such."""
    where = tmp_path_factory.mktemp("names")
    fix = {"latitude": -40.0, "longitude": 152.0, "frame_id": EVIL}
    adcp = {"velocity": [[0.1]], EVIL: EVIL}
    kinds = {"fix": ("foxglove.LocationFix", fix), "adcp": ("replay_kit.AdcpPing", adcp)}
    messages = [
        Message(10**18 + k * 10**9, f"/{topic}{EVIL}", *kind, 0, k)
        for k in range(3)
        for topic, kind in (kinds | {"other": (EVIL, adcp)}).items()
    ]
    write_mcap_log(where / f"{EVIL}.mcap", messages)
    shutil.copyfile(SAMPLES / "ensemble.nc", where / f"{EVIL}.nc")
    with h5py.File(where / f"bad{EVIL}.nc", "w") as file:
        file.create_dataset(EVIL, data=[1.0])
    return where


@pytest.mark.parametrize(
    ("line", "code"),
    [
        ("info X.mcap", 0),
        ("info X.mcap -v", 0),
        ("info --ensemble X.nc", 0),
        ("info --ensemble badX.nc", 0),
        ("info badX.nc", 3),
        ("info missingX.mcap", 3),
        ("qc X.mcap", 3),
        ("convert X.mcap -o copyX.mcap --overwrite", 0),
        ("replay X.mcap --ensemble X.nc -o outX.mcap", 3),
        ("replay X.mcap --ensemble X.nc --config X.toml -o out.mcap", 2),
        ("replay X.mcap --ensemble X.nc --remap X -o out.mcap", 2),
        ("smooth X.mcap --ensemble X.nc -o outX.mcap", 3),
        ("verify X.mcap", 3),
        ("report X.mcap", 3),
        ("plot X.mcap map -o map.png", 3),
        ("export X.mcap -o series.csv", 3),
        ("plan badX.nc --start 152,-40,0 --goal 152.1,-40,10", 3),
        ("twin --truth badX.nc -o twin.mcap", 3),
        ("info --X", 2),
        ("X", 2),
    ],
)
def test_no_command_obeys_a_name(folder, monkeypatch, line, code):
    monkeypatch.chdir(folder)
    check(invoke([word.replace("X", EVIL) for word in line.split()]), code)


def test_what_commands_answer_as_json_holds_names_as_they_are(folder, monkeypatch):
    monkeypatch.chdir(folder)
    outcome = invoke(["info", f"{EVIL}.mcap", "--json", "-"])
    assert "\x1b" not in outcome.stdout
    # of a name that is no text
    assert "missing\\udcff" in invoke(["info", "missing\udcff"]).stderr
    assert any(EVIL in text for text in _texts(json.loads(outcome.stdout)))


def _texts(value: object) -> list[str]:
    if isinstance(value, dict):
        return [text for pair in value.items() for part in pair for text in _texts(part)]
    if isinstance(value, list):
        return [text for part in value for text in _texts(part)]
    return [value] if isinstance(value, str) else []


def test_tables_show_names_in_cells_headings_and_titles(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    table = Table(title=EVIL)
    table.add_column(EVIL)
    table.add_row(EVIL)
    console_beside().print(table, EVIL)
    said = capsys.readouterr().out
    assert said.count(SHOWN) == 4
    assert "\x1b" not in said
