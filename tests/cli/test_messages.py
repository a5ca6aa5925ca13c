"""What the command line says of the mistakes that are made most, word by word."""

import pytest
import xarray as xr

from replay_kit.config.run import RunConfig
from tests.command import invoke, words_of
from tests.workflows.replay.interrupted import make_ocean


@pytest.fixture(scope="module")
def ocean(tmp_path_factory):
    folder = make_ocean(tmp_path_factory.mktemp("ocean"), RunConfig(), 12)
    with xr.open_dataset(folder / "ensemble.nc") as opened:
        moved = opened.load()
    moved.assign_coords(lon=moved.lon + 10.0).to_netcdf(folder / "elsewhere.nc", engine="h5netcdf")
    return folder


def said(ocean, more, ensemble="ensemble.nc", code=2):
    """Return what a replay that is refused says."""
    files = f"{ocean / 'glider.mcap'} --ensemble {ocean / ensemble} -o {ocean / 'never.mcap'}"
    done = invoke([*f"replay {files}".split(), *words_of(more)])
    assert done.exit_code == code, done.output
    assert not list(ocean.glob("never*"))
    return done.stderr.removeprefix("replay-kit: ").removesuffix("\n")


@pytest.mark.parametrize(
    ("goal", "why"),
    [
        ("-61.8,16.1", "DEPTH is missing"),
        ("-61.8", "LAT and DEPTH are missing"),
        ("1,2,3,4", "4 numbers instead of 3"),
        ("61.8W,16.1,300", "write -61.8 for 61.8W"),
        ("61.8,16.1 n,300", "write 16.1 for 16.1 n"),
        ("61.8,,300", "'' is no finite number"),
        ("61.8,nan,300", "'nan' is no finite number"),
        ("-40.1,152.8,300", "outside -90..90; did you mean --goal=152.8,-40.1,300?"),
        ("100,152.8,300", "the latitude 152.8 is outside -90..90; give a place on the Earth"),
    ],
)
def test_what_is_wrong_with_a_place(ocean, goal, why):
    found = said(ocean, [f"--goal={goal}"])
    assert found.startswith(f"--goal: expected LON,LAT,DEPTH, got '{goal}': ")
    assert why in found


def test_a_place_whose_swapped_numbers_lie_in_the_region_is_asked_about(ocean, tmp_path):
    with xr.open_dataset(ocean / "ensemble.nc") as opened:
        near = opened.load()
    near.assign_coords(lon=near.lon - 90.0).to_netcdf(tmp_path / "near.nc", engine="h5netcdf")
    for goal, words in (
        ("-39.8,62.2,100", "did you mean 62.2,-39.8,100? Longitude is the first number"),
        # one that is in the region neither way
        ("-30,62.2,100", "choose a place inside it or a forecast that covers it"),
    ):
        answer = said(ocean, f"--goal={goal}", ensemble=tmp_path / "near.nc", code=3)
        assert "62.20000, 100 m is outside the forecast's region" in answer
        assert words in answer


def test_a_goal_outside_is_told_from_a_log_outside(ocean):
    answer = said(ocean, "--goal=10,-40,100", code=3)
    assert answer.startswith("goal at 10.00000, -40.00000, 100 m is outside the forecast's region")
    assert "The whole log" not in answer
    answer = said(ocean, "--goal=152.2,-39.8,100", ensemble="elsewhere.nc", code=3)
    assert "The whole log lies outside it too, in 152." in answer
    assert "use an ensemble of that place, or --place-ensemble" in answer


@pytest.mark.parametrize("span", ["--start 2019-01-01", "--start 2018-01-01 --end 2018-11-15"])
def test_a_time_span_without_messages_is_told_that_of_the_log(ocean, span):
    told = "no message lies there; the log spans 2018-11-16T00:00:00Z to 2018-11-16T0"
    assert said(ocean, span).startswith(f"{span.replace(' --end', ' and --end')}: {told}")


def test_an_option_is_not_blamed_on_the_file(ocean, tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[planner]\nspeed = -1.0\n[logs]\nstart = 'yesterday'\n")
    wrong = "'logs.start': 'yesterday' is no time; write ISO 8601 UTC such as 2018-11-16T00:00:00Z"
    words = "expected a number above 0, or a range as 100:700, got"
    speed = f"'planner.speed': {words} -1.0"
    assert said(ocean, "--start yesterday") == f"options: {wrong}"
    assert said(ocean, f"--config {path}") == f"{path}: {wrong}; {speed}"
    assert said(ocean, f"--config {path} --start 2018-11-16 --depth=0") == (
        f"{path}: {speed}; options: 'planner.depth': {words} '0'"
    )


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("[planner]\nspeed = 0.3\nspeed = 0.4\n", "line 3: the key 'speed' is repeated; keep one"),
        ("[planner]\n[planner]\n", "line 2: the table [planner] is repeated; keep one"),
        ("[planner\n", "not TOML: Expected ']' at the end of a table declaration"),
    ],
)
def test_a_repeated_key_is_named_with_its_line(ocean, tmp_path, text, why):
    path = tmp_path / "run.toml"
    path.write_text(text)
    assert said(ocean, f"--config {path}").startswith(f"{path}: {why}")


def test_options_before_the_command_are_those_of_the_command():
    done = invoke("--start yesterday -q replay a.mcap --ensemble e.nc -o o.mcap")
    assert done.stderr.startswith("replay-kit: options: 'logs.start': 'yesterday' is no time")
