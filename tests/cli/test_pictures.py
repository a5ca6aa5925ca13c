"""The commands on results, and the scripts beside the sample logs."""

import re
import runpy
import sys
from unittest import mock

import pytest

import replay_kit as rk
from tests.command import run_command
from tests.places import SAMPLES
from tests.workflows.replay.interrupted import make_ocean

SETTINGS = {
    "logs": {"end": "2018-11-16T06:00:00Z"},
    "forecast": {"levels": [5, 150, 500]},
    "estimator": {"modes": 6, "sample_share": 0.5, "shift_distance": 0.0},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pictures")
    files = SAMPLES / "glider.mcap", SAMPLES / "ensemble.nc"
    rk.replay(*files, settings=SETTINGS, out=folder / "r.mcap")
    return folder


def run(folder, line):
    done = run_command(folder, line)
    return done.returncode, done.stdout.strip() or done.stderr


def test_plot_and_export_say_what_they_wrote_and_keep_what_exists(folder):
    assert run(folder, "plot r.mcap dac -o f.svg") == (0, "Figure: f.svg")
    assert "mean current, eastward" in (folder / "f.svg").read_text()
    code, said = run(folder, "plot r.mcap dac -o f.svg")
    assert (code, "--overwrite" in said) == (2, True)
    line = "export r.mcap --at=152.6,-40,150 -o x.csv"
    assert run(folder, line) == (0, "x.csv: series 2 rows")


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("plot r.mcap map -o f.jpg", "one of .png, .svg, .pdf"),
        ("plot r.mcap maps -o f.png", "maps"),
        ("export r.mcap -o x.xlsx", "one of .nc, .csv, .kml, .geojson"),
        ("export r.mcap -o y.csv --table series", "give --at LON,LAT,DEPTH"),
        ("plot r.mcap series --at=152.6,-40 -o f.png", "DEPTH is missing"),
    ],
)
def test_wrong_words_end_with_code_2(folder, line, says):
    code, said = run(folder, line)
    assert (code, says in said) == (2, True)


def test_a_result_that_is_cut_short_is_drawn_with_a_note(folder):
    whole = (folder / "r.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    assert run(folder, "plot cut.mcap trust -o cut.svg")[0] == 4
    assert "truncated" in (folder / "cut.svg").read_text()
    assert run(folder, "plot missing.mcap trust -o none.svg")[0] == 3


def script(capsys, name, *arguments):
    path = SAMPLES / name
    assert len(path.read_text(encoding="utf-8").splitlines()) < 30
    with mock.patch.object(sys, "argv", [name, *map(str, arguments)]):
        runpy.run_path(str(path), run_name="__main__")
    return capsys.readouterr().out.splitlines()


def test_the_script_of_a_dives_current(folder, capsys):
    lines = script(capsys, "dive_current.py", folder / "r.mcap", 1)
    assert lines[0].startswith("dive 1, 2018-11-16 00:04 to 02:50 UTC")
    measured = [float(word) for word in lines[1].split()[-2:]]
    # the dive's mean current in the log is 1.5 and 23.0 cm/s; the mean of the estimate through time stands for that along the path
    assert measured == pytest.approx([1.5, 23.0], abs=0.4)
    with pytest.raises(SystemExit, match="dive 99 has no mean current; choose one of 1"):
        script(capsys, "dive_current.py", folder / "r.mcap", 99)


def test_the_script_of_the_next_three_days(folder, capsys):
    lines = script(capsys, "next_three_days.py", folder / "r.mcap", "153.0,-40.2,0")
    assert len(lines) == 2
    # a plan has its odds: fewer than 90 % of the samples of this estimate arrive
    assert lines[1].split()[:2] == ["153.0,-40.2,0", "uncertain"]
    assert float(lines[1].split()[2]) < 72.0


def test_the_script_that_feeds_a_log_as_it_comes(tmp_path, capsys):
    ocean = make_ocean(tmp_path, rk.RunConfig(), 45)
    files, goal = (ocean / "glider.mcap", ocean / "ensemble.nc"), "152.5,-39.9,0"
    lines = script(capsys, "as_it_comes.py", *files, goal)
    assert lines
    assert all(re.search(r"at 100 m .* m/s  steer +\d+ degrees", line) for line in lines)
