"""Folders as logs: the parts of a ROS 2 bag, a glider's files, and readers that other packages register."""

from importlib.metadata import EntryPoint
from pathlib import Path

import pytest

from replay_kit.core import extensions
from replay_kit.core.errors import LogError
from replay_kit.logs import LogFormat, open_log, open_logs
from replay_kit.logs.mcap.reader import McapReader
from tests.logs.log_samples import json_mcap
from tests.logs.netcdf import glider_samples

METADATA = """rosbag2_bagfile_information:
  version: 5
  relative_file_paths:
    - {}
    - "{}"
  duration:
    nanoseconds: 1
"""


def _bag(folder):
    (folder / "metadata.yaml").write_text(METADATA.format("b_0.mcap", "b_1.mcap"))
    for part in (0, 1):
        (folder / f"b_{part}.mcap").write_bytes(json_mcap(range(10 * part, 10 * part + 10)))
    (folder / "a_stray.mcap").write_bytes(json_mcap(range(3)))
    return folder


def test_a_bag_is_the_files_that_its_metadata_lists(tmp_path):
    logs = open_logs([_bag(tmp_path)])
    found = [(Path(log.path).name, log.input, log.format) for log in logs]
    assert found == [("b_0.mcap", 0, "mcap"), ("b_1.mcap", 1, "mcap")]
    assert sum(len(list(log.messages())) for log in logs) == 20
    with pytest.raises(LogError, match="expected a folder with one log, it holds 2"):
        open_log(tmp_path)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        (
            "metadata.yaml",
            METADATA.format("b_0.mcap", "b_1.mcap"),
            r"missing: b_0\.mcap, b_1\.mcap",
        ),
        ("metadata.yaml", METADATA.format("b.mcap.zstd", "c.mcap"), r"with: zstd -d b\.mcap\.zstd"),
        ("notes.txt", "x", r"the folder holds notes\.txt; give the logs themselves"),
    ],
)
def test_a_folder_that_lacks_logs_is_refused(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(LogError, match=words):
        open_logs([tmp_path])


def test_logs_keep_the_order_in_which_they_are_given_twice_too(tmp_path):
    log, dive = tmp_path / "a.mcap", glider_samples.bodc(tmp_path / "b.nc")
    log.write_bytes(json_mcap(range(3)))
    given = [log, dive, log, *glider_samples.gliderdac(tmp_path / "c")]
    found = [(log.files[0], log.input) for log in open_logs(given)]
    assert found == [(log, 0), (dive, 1), (log, 2), (given[3], 3)]
    assert [log.files for log in open_logs([dive, log, dive])] == [(dive,), (log,), (dive,)]


def test_profiles_of_two_missions_are_two_logs_and_a_folder_with_both_needs_a_choice(tmp_path):
    raw = tmp_path / "raw"
    first, second = glider_samples.seaexplorer(raw)
    other = raw / "SEA063.23.gli.sub.1"
    other.write_text(first.read_text())
    one, two = open_logs([raw], several_missions=True)
    assert (one.files, one.mission) == ((first, second), "sea063.22")
    assert (two.files, two.report().mission) == ((other,), "sea063.23")
    # each is named by the one who gives both
    assert len(open_logs([first, second])) == 1
    assert len(open_logs([first, second, other])) == 2
    (raw / "notes.mcap").write_bytes(json_mcap(range(3)))
    names = r"sea063.22 \(SEA063.22.gli.sub.\*\), sea063.23 \(SEA063.23.gli.sub.1\)"
    with pytest.raises(
        LogError, match=rf"holds 2: {names}; give the files of one of them, such as"
    ):
        open_logs([raw])


FORM = LogFormat("mine", "a log of mine", McapReader, magic=b"MINE", endings=r".*\.mine")


def test_another_package_may_read_a_form_of_its_own(tmp_path, monkeypatch):
    point = EntryPoint("mine", "tests.logs.test_folders:FORM", "replay_kit.logs")
    monkeypatch.setattr(extensions, "_points", lambda kind: (point,) if kind == "logs" else ())
    (tmp_path / "a.mine").write_bytes(b"MINE")
    (tmp_path / "a.xyz").write_bytes(b"YOURS")
    assert isinstance(open_log(tmp_path), McapReader)
    with pytest.raises(LogError, match=r"expected an MCAP file, .* or a log of mine"):
        open_log(tmp_path / "a.xyz")
