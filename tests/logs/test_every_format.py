"""What holds for the logs of every format: a row of the table, and a sound file of it."""

import re

import orjson
import pytest

from replay_kit.config.run import LogConfig
from replay_kit.core.errors import LogError
from replay_kit.logs import FORMATS, open_log
from replay_kit.workflows.convert import convert
from tests.command import run_command
from tests.fuzz.damage import bursts, ensembles, frames, records
from tests.logs.sound import SOUND
from tests.places import ROOT

#: How a reader says more exactly which format it is.
NAMES = {"netcdf": "spray", "slocum": "slocum-binary", "radials": "radar-radials"}
each = pytest.mark.parametrize("form", FORMATS, ids=lambda form: form.name)


@pytest.fixture
def path(tmp_path, form):
    made = tmp_path / "made"
    made.mkdir()
    (tmp_path / "log").write_bytes(SOUND[form.name](made))
    return tmp_path / "log"


def said(log):
    """Return all messages, NaN as null."""
    return [(*m[:3], orjson.dumps(m.payload), m.position) for m in log.messages()]


@each
def test_a_log_is_recognised_by_its_bytes_and_every_pass_says_the_same(path, form):
    head = path.read_bytes()[: 1 << 16]
    by_magic = [other.name for other in FORMATS if other.magic and re.match(other.magic, head)]
    assert by_magic in ([], [form.name])
    with open_log(path, 3) as log:
        assert log.format == NAMES.get(form.name, form.name)
        assert {message.input for message in log.messages()} == {3}
        passes = [log.messages(), log.messages()]
        assert len({repr(next(messages)) for messages in passes}) == 1
        before = said(log)
    # the end of the context has closed the passes that were not finished
    assert all(handle.closed for handle in log._files)
    assert said(log) == before
    report = log.report()
    assert [row[-1] for row in before] == sorted(row[-1] for row in before)
    counted = sum(report.read.values()) - sum(n for n, _ in report.undecodable.values())
    assert (len(before), report.losses) == (counted, ())


@each
def test_a_file_that_vanished_is_an_error_of_ours(path, form):
    with open_log(path) as log:
        path.unlink()
        if form.grows and form.name not in ("pd0", "ad2cp"):
            with pytest.raises(LogError, match="cannot be read: No such file"):
                next(log.messages())
    with pytest.raises(LogError, match="file not found"):
        open_log(path)


@each
def test_what_is_converted_says_the_same_and_a_topic_takes_its_new_name(path, form, tmp_path):
    log = open_log(path)
    by_time = sorted(said(log), key=lambda row: row[0])
    first = by_time[0][1]
    summary = convert([path], tmp_path / "out.mcap", False, LogConfig(remap={first: "/other"}))
    found = sorted(said(open_log(summary.out)), key=lambda row: row[0])
    renamed = [(row[0], "/other" if row[1] == first else row[1], *row[2:-1]) for row in by_time]
    assert [row[:-1] for row in found] == renamed
    topics = {row[1] for row in renamed}
    assert topics == summary.messages.keys() - {"mavlink/frames"}
    log = open_log(path, 0, LogConfig(remap={first: "/other"}))
    assert {message.topic for message in log.messages()} == topics <= log.report().read.keys()


@each
def test_info_and_convert_say_what_no_checksum_covers(path, form, tmp_path):
    log = open_log(path)
    assert log.report().unchecked == {}
    said(log)
    count = sum(log.report().read.values()) if form.unchecked else 0
    assert dict(log.report().unchecked) == ({form.unchecked: count} if count else {})
    line = f"Without a checksum, so that damage cannot be detected: log: {form.unchecked} ({count})"
    commands = "info log", "convert log -o out.mcap --overwrite"
    for command in commands:
        done = run_command(tmp_path, command)
        assert (line in " ".join((done.stdout + done.stderr).split())) is bool(count)
    info, copy = (orjson.loads(run_command(tmp_path, f"{one} --json -").stdout) for one in commands)
    assert info["logs"][0]["unchecked"] == dict(log.report().unchecked)
    told = [{"file": "log", "what": form.unchecked, "count": count}]
    assert copy["unchecked"] == (told if count else [])


@pytest.mark.parametrize("name", ["tlog", "dataflash", "pd0", "ad2cp"])
def test_bytes_before_between_and_after_records_are_skipped_and_counted(tmp_path, name):
    data, noise = SOUND[name](tmp_path), b"\xfe\xfd\x00\xa3\x95\x7f\xa5" * 3
    (tmp_path / "sound").write_bytes(data)
    log = open_log(tmp_path / "sound")
    sound, middle = said(log), _boundary(data, name)
    parts = data[:middle], noise, data[middle:], noise
    (tmp_path / "log").write_bytes(b"".join(parts))
    log = open_log(tmp_path / "log")
    assert [row[:-1] for row in said(log)] == [row[:-1] for row in sound]
    places = [(loss.offset, loss.bytes) for loss in log.report().losses]
    assert places == [(middle, len(noise)), (len(data) + len(noise), len(noise))]


def _boundary(data, name):
    """Return where a record ends, by the walkers of the format."""
    walk = {"tlog": frames, "dataflash": records, "pd0": ensembles, "ad2cp": bursts}[name]
    return walk(data)[-3][1]


def test_the_page_of_formats_is_the_table():
    rows = [
        f"| `{form.name}` | {form.title} | {'yes' if form.grows else ''} | {form.unchecked} |"
        for form in FORMATS
    ]
    assert "\n".join(rows) in (ROOT / "replay_kit/logs/README.md").read_text()
