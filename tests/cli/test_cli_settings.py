"""Options made from the settings: each means what the key in a file means, ``config`` lists all keys, and help is quick to have."""

import re
import subprocess
import sys
import tomllib
from dataclasses import replace

import pytest

from replay_kit.cli.settings import Settings, every_setting, takes_settings
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import ConfigError
from tests.command import invoke, succeed
from tests.places import ROOT
from tests.planners.flow_samples import eddying_flow
from tests.results.cases import write
from tests.results.conftest import innovation, plan  # noqa: F401 - fixtures
from tests.synthetic_flow import synthetic_flow

# fixtures of other modules are imported by their names
# ruff: noqa: F811

# as a file and as options have them
SAME = [
    ("logs.remap", "{ '/a' = '/b', '/c' = '/d' }", ["/a=/b", "/c=/d"]),
    ("logs.clock", "'header'", "header"),
    ("logs.start", "'2018-11-16'", "2018-11-16"),
    ("forecast.region", "[-10, 20.5, -5, 25]", "-10,20.5,-5,25"),
    ("forecast.levels", "[5, 150]", "5,150"),
    ("forecast.place", "true", True),
    ("estimator.modes", "'all'", "all"),
    ("time.scale", "'static'", "static"),
    ("time.scale", "86400.0", "86400"),
    ("time.oscillators", "['M2', 'inertial']", "M2,inertial"),
    ("measurements.dead_reckoning", "'through_water'", "through_water"),
    ("planner.depth", "300", "300"),
    ("plan.goal", "['152,-40,0', '153,-40,0']", ["152,-40,0", "153,-40,0"]),
    ("plan.risk", "0.1", "0.1"),
]


def given(path: str, value: object, **more: object) -> Settings:
    """Return the settings of a command whose only option is that of one setting."""

    @takes_settings(path)
    def command(settings: Settings) -> int:
        return 0

    kind = command.__kwdefaults__["settings"].__class__
    return kind(**{path.replace(".", "__"): value}, **more)


@pytest.mark.parametrize(("path", "text", "value"), SAME)
def test_an_option_means_what_the_key_in_a_file_means(path, text, value, tmp_path):
    section, _, key = path.rpartition(".")
    (tmp_path / "run.toml").write_text(f"[{section}]\n{key} = {text}\n")
    assert given(path, value).load() == load_config(tmp_path / "run.toml") != RunConfig()


def test_options_win_over_the_file_and_leave_its_other_keys(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text("[planner]\ndepth = 300.0\nradius = 50.0\n")
    planner = given("planner.depth", "400", config=path).load().planner
    assert (planner.depth, planner.radius) == (400.0, 50.0)
    with pytest.raises(ConfigError, match=r"'planner\.radius': .* got 'wide'"):
        given("planner.radius", "wide").load()


def test_config_lists_every_setting_as_a_file_that_can_be_read(tmp_path):
    said = succeed("config").stdout
    keys = [path.rpartition(".") for path, _ in every_setting()]
    tables = tomllib.loads(re.sub(r"(?m)^#(\w+ = .+)$", r"\1", said))
    for section, _, key in keys:
        assert f"\n#{key} = " in said.partition(f"[{section}]\n")[2].partition("\n[")[0] + "\n"
    # what has a default is a line that counts once it is uncommented
    (tmp_path / "run.toml").write_text(re.sub(r"(?m)^#(\w+ = \S.*)$", r"\1", said))
    assert load_config(tmp_path / "run.toml") == RunConfig()
    assert tables["planner"]["kind"] == "auto"
    assert succeed("config planner gating").stdout.count("\n[") == 1
    assert "expected sections of logs, measurements" in invoke("config nothing").stderr


def test_help_and_refusals_load_no_library_that_takes_long():
    for arguments in ("replay --help", "replay a.mcap --nope", "plan --help", "--version"):
        assert slow_libraries(arguments) == "[]", arguments


def test_what_is_in_a_log_is_told_without_the_libraries_of_forecasts_and_plans():
    assert slow_libraries("info sample_logs/glider.mcap") == "['mcap', 'numpy']"


def test_a_plan_of_a_file_that_is_not_there_is_refused_before_the_planners_are_loaded():
    assert (
        slow_libraries("plan nowhere.nc --start=152,-40,0 --goal=152.1,-40,0 --objective energy")
        == "['numpy']"
    )


def test_a_plan_loads_no_more_than_it_needs(tmp_path):
    flow = tmp_path / "flow.nc"
    eddying_flow(1).save(flow)
    line = f"plan {flow} --start=152.5,-40,0 --samples=0 --goal="
    assert slow_libraries(f"{line}160,-40,0") == "['h5py', 'numpy']"
    found = loaded(f"{line}152.55,-40,0")
    assert not found.intersection(["scipy", "xarray", "mcap", "replay_kit.estimator"])
    assert "planners.route.front" in found


def test_what_shows_a_result_opens_it_once_and_loads_no_reader_of_logs(tmp_path, innovation, plan):
    innovations = [replace(innovation, dive=k + 1) for k in range(4)]
    path = write(tmp_path / "r.mcap", synthetic_flow(), innovations, plan).result.path
    lines = ("status {0}", "export {0} -o {0}.kml", "plot {0} trust -o {0}.svg")
    lines = (*lines, "report {0} -o {0}.html")
    found, opened = loaded_and_opened(*(line.format(path) for line in lines))
    foreign = ("replay_kit.logs", "replay_kit.estimator", "planners", "scipy.stats")
    assert [name for name in found if name.startswith(foreign)] == []
    assert opened == [str(path)] * len(lines)


def slow_libraries(line: str) -> str:
    """Return which of the libraries that take long to load a command loads."""
    slow = "numpy scipy xarray pandas matplotlib casadi h5py mcap pymavlink"
    return str(sorted(loaded(line).intersection(slow.split())))


def loaded(line: str) -> set[str]:
    """Return the modules that a command loads."""
    return loaded_and_opened(line)[0]


def loaded_and_opened(*lines: str) -> tuple[set[str], list[str]]:
    """Return the modules that commands load, and the results that they open, each as often as they do."""
    code = (
        "import sys\nfiles = []\n"
        "sys.addaudithook(lambda name, args: name == 'open' and files.append(str(args[0])))\n"
        "from replay_kit.cli.app import main\n"
        "for line in sys.argv[1:]:\n"
        "    sys.argv[1:] = line.split()\n"
        "    try: main()\n    except SystemExit: pass\n"
        "print(*sys.modules, '|', *files)"
    )
    names, _, files = python("-c", code, *lines).splitlines()[-1].partition("|")
    return set(names.split()), [name for name in files.split() if name.endswith(".mcap")]


def python(*arguments: str, env: dict[str, str] | None = None) -> str:
    """Return what a process of its own prints."""
    command = [sys.executable, *arguments]
    return subprocess.run(
        command, env=env, cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout
