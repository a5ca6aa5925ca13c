"""The table of log formats: each names the reader that reports it, and a log is a context that closes unfinished passes."""

import re

import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs import FORMATS, open_log
from tests.logs.log_samples import json_mcap, tlog
from tests.logs.mavlink.dataflash_samples import dataflash, declarations
from tests.places import ROOT


@pytest.fixture
def files(tmp_path):
    made = {
        "mcap": json_mcap(range(3000)),
        "tlog": b"".join(tlog(30)),
        "dataflash": b"".join([declarations(), *dataflash(30)]),
    }
    for name, data in made.items():
        (tmp_path / name).write_bytes(data)
    return [tmp_path / name for name in made]


def test_a_format_is_recognised_by_its_first_bytes_alone(files):
    for file in files:
        head = file.read_bytes()[: 1 << 16]
        begin = [form.name for form in FORMATS if form.magic and re.match(form.magic, head)]
        assert begin in ([], [file.name])
        assert open_log(file).format == file.name


def test_the_end_of_the_context_closes_unfinished_passes(files):
    for file in files:
        with open_log(file) as log:
            passes = [log.messages(), log.messages()]
            first = [next(messages) for messages in passes]
            assert first[0] == first[1]
        assert not log._files or all(handle.closed for handle in log._files)
        if file.name == "mcap":
            with pytest.raises(ValueError, match="closed file"):
                list(passes[1])


def test_a_log_can_be_read_again_after_its_context(files):
    for file in files:
        with open_log(file) as log:
            before = repr(list(log.messages()))
        assert repr(list(log.messages())) == before  # as text: some values are NaN


def test_a_file_that_vanished_is_an_error_of_ours(files):
    for file in files:
        with open_log(file) as log:
            file.unlink()
            with pytest.raises(LogError, match="cannot be read: No such file"):
                next(log.messages())


def test_the_page_of_formats_is_the_table():
    rows = [
        f"| `{form.name}` | {form.title} | {'yes' if form.grows else ''} | {form.unchecked} |"
        for form in FORMATS
    ]
    assert "\n".join(rows) in (ROOT / "replay_kit/logs/README.md").read_text()
