"""The registry of log formats: each names the reader that reports it, and a log is a context that closes unfinished passes."""

import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.registry import FORMATS
from tests.logs.dataflash_samples import dataflash, declarations
from tests.logs.log_samples import json_mcap, tlog


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
        assert [form.name for form in FORMATS if form.recognises(head)] == [file.name]
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
