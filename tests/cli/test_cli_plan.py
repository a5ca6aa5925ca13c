"""The command that plans a mission: what it writes, and what it refuses."""

import hashlib
import json
from dataclasses import replace
from unittest.mock import Mock

import pytest
from mcap.reader import make_reader
from threadpoolctl import threadpool_info, threadpool_limits

from planners import MissionSettings, waypoints_of
from planners.clearance import Violation
from replay_kit import __version__, open_estimate
from replay_kit.config.run import load_config
from replay_kit.core.errors import PlanError
from replay_kit.results import difference
from replay_kit.workflows.planning import run as plans
from tests.command import invoke, succeed
from tests.planners.flow_samples import uncertain_flow
from tests.results.result_samples import decoded, metadata_of

PLACES = "--start=152.42,-40.0,0 --goal=152.52,-39.96,0"
ASK = f"{PLACES} --depth 390"


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "flow.nc"
    uncertain_flow().save(path)
    return path


def answer(flow, asked, code=0):
    """The answer of a plan in JSON, and what it says beside it."""
    done = invoke(f"plan {flow} {asked} --json -")
    assert done.exit_code == code, done.output
    return json.loads(done.stdout), done.stderr


def areas_in(path, *rings):
    """A file of areas by the name of banks."""
    geometry = {"type": "MultiPolygon", "coordinates": [[ring] for ring in rings]}
    feature = {"type": "Feature", "properties": {"name": "banks"}, "geometry": geometry}
    path.write_text(json.dumps(feature))
    return path


def box(west, south, east, north):
    return [[west, south], [east, south], [east, north], [west, north], [west, south]]


def test_everything_it_writes_agrees(flow, tmp_path):
    out, geojson, table, json_file = (
        tmp_path / f"plan.{kind}" for kind in ("mcap", "geojson", "csv", "json")
    )
    files = f"-o {out} --geojson {geojson} --csv {table} --json {json_file}"
    done = succeed(f"plan {flow} {ASK} {files} --samples 10")
    said = json.loads(json_file.read_text())
    assert said["status"] == "reached"
    assert said["message"] in done.output
    # no log tells how the vehicle flies; the depth is stated
    assert said["message"].endswith("; assumed: 0.30 m/s")
    assert said["samples"]["count"] == 10
    assert len(table.read_text().splitlines()) == len(said["legs"]) + 1
    assert said["legs"][-1]["ellipse_major_m"] > 0.0
    properties = json.loads(geojson.read_text())["features"][0]["properties"]
    assert properties["duration_s"] == said["duration_s"]
    ((time_ns, controls),) = decoded(out)["/plan/controls"]
    assert (time_ns, controls.status, controls.message) == (10**18, "reached", said["message"])
    assert controls.duration == pytest.approx(said["duration_s"])


def test_its_files_are_whole_when_a_reader_of_its_table_stops_early(flow, tmp_path, monkeypatch):
    closed = Mock(side_effect=BrokenPipeError)
    monkeypatch.setattr("replay_kit.workflows.planning.outputs.print_plans", closed)
    out, json_file = tmp_path / "plan.mcap", tmp_path / "plan.json"
    with pytest.raises(BrokenPipeError):
        invoke(f"plan {flow} {ASK} -o {out} --json {json_file} --samples 0")
    assert json.loads(json_file.read_text())["status"] == "reached"
    with out.open("rb") as file:
        assert make_reader(file).get_summary() is not None


@pytest.mark.parametrize("threads", [1, 2])
def test_a_plan_is_computed_with_as_many_threads_as_are_asked_for(
    flow, tmp_path, monkeypatch, threads
):
    used, config = set(), tmp_path / "run.toml"
    config.write_text("[output]\nthreads = 2\n" if threads == 2 else "")

    def counted(*_):
        used.update(one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas")
        raise PlanError("counted")

    monkeypatch.setattr(plans, "plan_mission", counted)
    with threadpool_limits(limits=3):
        invoke(f"plan {flow} {ASK} --samples 0 --config {config}")
    assert used == {threads}


def config_in(path):
    """The configuration that is attached to a plan's result."""
    with path.open("rb") as file:
        (config,) = (
            one.data for one in make_reader(file).iter_attachments() if one.name == "config.toml"
        )
    return config.decode()


def test_a_plan_says_what_it_was_made_of_and_can_be_made_again(flow, tmp_path):
    config, out, again, attached = (
        tmp_path / name for name in ("run.toml", "plan.mcap", "again.mcap", "attached.toml")
    )
    config.write_text(
        "[planner]\nmax_angle = 30.0\nlegs = 3\n[measurements]\nsurface_depth = 4.0\n"
    )
    areas = areas_in(tmp_path / "areas.geojson", box(150.0, -45.0, 150.1, -44.9))
    succeed(f"plan {flow} {ASK} --config {config} --no-go {areas} --objective energy -o {out}")
    metadata = metadata_of(out)
    assert metadata["replay_kit.inputs"] == {
        name: f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
        for name, path in {"flow0": flow, "no_go": areas}.items()
    }
    options = metadata["replay_kit.options"]
    assert (options["start"], options["goals"]) == ("152.42,-40.0,0", "152.52,-39.96,0")
    assert metadata["replay_kit.versions"]["replay-kit"] == __version__
    attached.write_text(config_in(out))
    held = load_config(attached)
    planner, surface = held.planner, held.measurements.surface_depth
    assert (planner.kind, planner.objective, planner.legs) == ("mission", "energy", 3)
    assert (planner.max_angle, planner.depth, surface) == (30.0, 390.0, 4.0)
    assert planner.max_duration == MissionSettings().max_duration
    succeed(f"plan {flow} {PLACES} --config {attached} --no-go {areas} -o {again}")
    assert config_in(again) == attached.read_text()
    assert difference(out, again).same


@pytest.mark.full
def test_areas_are_kept_clear_of_and_a_risk_is_kept(flow, tmp_path):
    areas = areas_in(tmp_path / "areas.geojson", box(152.46, -40.06, 152.475, -39.97))
    free, past = (answer(flow, f"{ASK} {more}")[0] for more in ("", f"--no-go {areas} --samples 5"))
    assert past["status"] == ("unsafe" if past["samples"]["safe"] < 0.9 else "reached")
    assert past["duration_s"] > free["duration_s"]
    assert (past["samples"]["safe"] == 1.0) == (past["samples"]["violations"] == {})
    assert past["samples"]["allowed"] is None
    config = tmp_path / "run.toml"
    config.write_text(f"[planner]\nlegs = {len(past['legs'])}\n")
    done = invoke(
        f"plan {flow} {ASK} --json - --no-go {areas} --samples 5 --risk 0.2 --config {config}"
    )
    wide = json.loads(done.stdout)
    assert wide["duration_s"] >= past["duration_s"] * (1.0 - 1e-4)
    violating = 1.0 - wide["samples"]["safe"]
    assert done.exit_code == (0 if violating <= 0.2 else 7)


def test_a_list_that_is_withheld_names_the_tolerance_that_helps(flow, tmp_path, monkeypatch):

    def crossing(flow, plan, request, tolerance, samples):
        few, odds = waypoints_of(flow, plan, request, tolerance, samples)
        at = Violation("land", 0.0, 1, 152.5, -40.0)
        return (few if tolerance == 62.5 else replace(few, violation=at)), odds

    monkeypatch.setattr(plans, "waypoints_of", crossing)
    places = tmp_path / "places.csv"
    line = f"plan {flow} {ASK} --samples 3 --waypoints {places}"
    withheld = invoke(line)
    assert (withheld.exit_code, places.exists()) == (7, False)
    assert " of 3 simulated flights that head for the waypoints come up" in withheld.output
    assert "the waypoints are not safe; --waypoint-tolerance 62.5 is safe" in withheld.output
    succeed(f"{line} --waypoint-tolerance 62.5")
    assert places.exists()


def test_a_track_farther_from_its_line_than_the_width_does_not_reach_the_goal(flow, tmp_path):
    (tmp_path / "run.toml").write_text("[planner]\nlegs = 4\n")
    asked = f"{ASK} --line --samples 0 --config {tmp_path}/run.toml"
    wide, narrow = (
        answer(flow, f"{asked} {more}")[0]
        for more in (f"-o {tmp_path}/plan.mcap", "--line-width 30")
    )
    assert (wide["status"], narrow["status"]) == ("reached", "unreachable")
    assert 30.0 < narrow["statistics"]["farthest_m"] <= wide["statistics"]["farthest_m"]
    assert "farther than 30 m" in narrow["message"]
    assert metadata_of(tmp_path / "plan.mcap")["replay_kit.options"]["line"] == "True"


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        ("--samples 2", 2, "three or more"),
        ("--csv - --json -", 2, "standard output"),
        ("--risk 0.1 --samples 0", 2, "--samples"),
        ("--arrive 1.1", 2, "--arrive"),
        ("--arrive-by 2001-09-09T00:00Z", 2, "a time after the start at 2001-09-09 01:46:40Z"),
        ("--arrive-by 0h", 2, "a duration above 0"),
        ("--time-limit 0", 2, "--time-limit"),
        ("--objective time=1,speed=2", 2, "--objective"),
        ("--angles 40,35", 2, "40 is above "),
        ("--angles 15", 2, "got '15': MAX is missing"),
        ("--mooring 500", 2, "RADIUS,HOURS"),
        ("--mooring 500,2 --line", 2, "--mooring: cannot be combined with --line"),
        ("--line --goal=152.5,-40,0", 2, "--goal: expected one with"),
        ("--mooring 500,2 --waypoints a.csv", 2, "combined with --waypoints"),
        ("--waypoints a.txt", 2, "ends in one of .csv, "),
        ("--surfacings-only", 2, "expected --mooring"),
        ("--line --line-width inf", 2, "a number above 0, got inf"),
        ("--mooring 500,2 --objective energy", 2, "combined with --objective"),
        ("--objective time=1,closest=0", 3, "a weight of 0"),
        ("--depth 4000", 3, "deepest level"),
        ("--max-depth 200", 3, "vehicle's limit, 200 m"),
        ("--goal=170,-40,0", 3, "outside the forecast"),
        ("--no-go none.kml", 3, "none.kml: expected an"),
    ],
)
def test_what_it_refuses(flow, more, code, words):
    # an option that is given anew here is not given twice
    done = invoke(f"plan {flow} {PLACES if '--depth' in more else ASK} {more}")
    assert words in str(done.exception)
    assert done.exit_code == code


def test_a_configuration_counts_here_too_and_options_win(flow, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text("[planner]\ndepth = 300.0\nmax_angle = 20.0\nsamples = 3\n")
    near = f"--start=152.42,-40.0,0 --goal=152.46,-40.0,0 --config {config}"
    configured, said = (
        answer(flow, f"{near} {more}")[0] for more in ("", "--depth 200 --samples 0")
    )
    assert {leg["depth_m"] for leg in configured["legs"]} == {300.0}
    assert {leg["depth_m"] for leg in said["legs"]} == {200.0}
    assert max(leg["glide_angle_deg"] for leg in said["legs"]) <= 20.0 + 1e-6
    assert (configured["samples"]["count"], said["samples"]) == (3, None)


def test_a_plan_is_judged_by_a_hundred_samples_and_its_message_leads_with_the_odds(flow):
    said, words = answer(flow, f"{ASK} --battery 10")
    share = said["samples"]["reached"]
    assert said["samples"]["count"] == 100
    assert (share >= 0.9, said["samples"]["held"]) == (True, None)
    lead = f"{round(100.0 * share)} of 100 simulated flights come up within 250 m of the goal by "
    assert said["message"].startswith(lead)
    assert words.startswith(f"reached: {lead}")
    # 2001-09-09 01:46:40Z is where it begins
    assert f"after {said['duration_s'] / 3600.0:.1f} h (2001-09-09 " in said["message"]
    used = f"{said['energy_j'] / 1e5:.1f} % of 10 MJ, {len(said['legs'])} legs at 0.30 m/s"
    assert used in words
    doubtful, _ = answer(flow, f"{ASK} --angles 15,16 --arrive 1")
    assert (doubtful["status"], doubtful["samples"]["reached"] < 1.0) == ("uncertain", True)
    assert "100 % are required" in doubtful["message"]


@pytest.mark.full
def test_a_risk_that_cannot_be_kept_ends_with_7_and_without_files(flow, tmp_path):
    # the goal lies 200 m from an area on either side
    bands = (box(152.49, y, 152.55, y + 0.03) for y in (-39.9918, -39.9582))
    files = tmp_path / "plan.mcap", tmp_path / "plan.csv"
    asked = f"{ASK} --no-go {areas_in(tmp_path / 'areas.geojson', *bands)} --risk 0.05"
    line = f"{asked} -o {files[0]} --csv {files[1]} --time-limit 0.1"
    said, words = answer(flow, line, code=7)
    assert said["status"] == "unsafe"
    assert "the risk of 5 % cannot be kept: the least found is" in words
    assert f"from banks {100.0 * said['samples']['violations']['banks']:.0f} %" in words
    assert "the time limit of 0.1 s ended the search" in said["message"]
    assert not any(path.exists() for path in files)
    answer(flow, f"{line} --write-unsafe", code=7)
    assert all(path.exists() for path in files)


def test_a_file_may_hold_what_is_asked_for(flow, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(
        "[planner]\ndepth = 390.0\n[plan]\nstart = '152.42,-40.0,0'\ngoal = ['152.52,-39.96,0']\narrive = 1\n"
    )
    held, given = (
        answer(flow, f"{asked} --samples 0")[0]["legs"]
        for asked in (f"--config {config}", f"{ASK} --arrive 1")
    )
    assert held == given != []
    config.write_text("[plan]\nrisky = 0.1\n")
    start, goal = PLACES.split()
    for asked, words in (
        (goal, "--start is missing; expected "),
        (start, "--goal is missing; expected "),
        (f"{ASK} --config {config}", "unknown key 'plan.risky'"),
    ):
        done = invoke(f"plan {flow} {asked}")
        assert (done.exit_code, words in done.output) == (2, True)


def test_an_estimate_without_uncertainty_has_no_odds_and_says_so(flow, tmp_path):
    mean = tmp_path / "mean.nc"
    open_estimate(flow).mean_flow().save(mean)
    said, _ = answer(mean, ASK)
    assert said["samples"] is None
    assert "states no uncertainty" in said["message"]
    for option in ("--objective odds", "--risk 0.1"):
        refused = invoke(f"plan {mean} {ASK} {option}")
        assert refused.exit_code == 3
        assert option.split()[0] in refused.output
        assert "so that it has no odds" in refused.output


@pytest.mark.full
def test_a_mission_for_the_odds_is_judged_in_other_samples_and_by_a_time(flow):
    narrow = f"{ASK} --angles 15,20"
    quickest, odds = (answer(flow, f"{narrow} {more}")[0] for more in ("", "--objective odds"))
    reached, (low, high) = odds["samples"]["reached"], odds["samples"]["reached_interval"]
    assert reached >= quickest["samples"]["reached"]
    assert len(odds["legs"]) >= len(quickest["legs"])
    assert low <= reached <= high
    assert f"90 % interval {100 * low:.0f} to {100 * high:.0f} %" in odds["message"]
    hours = 0.5 * quickest["duration_s"] / 3600.0
    late, _ = answer(flow, f"{narrow} --arrive-by {hours:.2f}h")
    assert (late["status"], late["samples"]["reached"]) == ("unreachable", 0.0)


def test_every_output_and_page_holds_a_plan_without_legs(flow, tmp_path):
    names = "plan.mcap", "plan.geojson", "plan.csv", "plan.json", "places.csv"
    out, geojson, table, json_file, places = (tmp_path / name for name in names)
    here = "--start=152.5,-40.0,0 --goal=152.5,-40.001,0 --depth 390 --risk 0.1 --samples 10"
    files = f"-o {out} --geojson {geojson} --csv {table} --json {json_file} --waypoints {places}"
    done = succeed(f"plan {flow} {here} {files}")
    assert "reached: already there: the start is within 111.0 m of the goal" in done.output
    said = json.loads(json_file.read_text())
    assert (said["status"], said["legs"]) == ("reached", [])
    assert (said["samples"], said["waypoints"]) == (None, None)
    features = json.loads(geojson.read_text())["features"]
    assert [feature["properties"]["name"] for feature in features] == ["start", "goal 1"]
    assert table.read_text() == "leg\n"
    # a list of no places is no file for a glider
    assert not places.exists()
    assert "no waypoints are written: the plan has no legs" in done.output
    page, figure = tmp_path / "plan.html", tmp_path / "plan.png"
    succeed(f"report {out} -o {page}")
    succeed(f"plot {out} plan -o {figure}")
    succeed(f"verify {out} --inputs {flow.parent}")
    assert "No command: already there" in page.read_text()
    status = invoke(f"status {out} --json -")
    assert json.loads(status.stdout)["command"]["heading_deg"] is None
    assert "no command: already there" in " ".join(status.stderr.split())
