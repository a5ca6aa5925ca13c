"""The command that plans a mission: what it writes, and what it refuses."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from mcap.reader import make_reader
from threadpoolctl import threadpool_info, threadpool_limits

from planners import MissionSettings, waypoints_of
from planners.clearance import Violation
from replay_kit import __version__
from replay_kit.config.run import load_config
from replay_kit.core.errors import PlanError
from replay_kit.core.flow.file import load
from replay_kit.results import difference
from replay_kit.workflows.planning.areas import read_areas
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from tests.command import invoke, succeed
from tests.planners.flow_samples import uncertain_flow
from tests.results.result_samples import decoded

ASK = "--start=152.42,-40.0,0 --goal=152.52,-39.96,0 --depth 390"


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    path = tmp_path_factory.mktemp("plan") / "flow.nc"
    uncertain_flow().save(path)
    return path


def run(line, code=0):
    done = invoke(f"plan {line}")
    if code == 0:
        assert done.exit_code == 0, done.output
    return done


def test_everything_it_writes_agrees(flow, tmp_path):
    out, geojson, table, answer = (
        tmp_path / name for name in ("plan.mcap", "plan.geojson", "plan.csv", "plan.json")
    )
    done = run(
        f"{flow} {ASK} -o {out} --geojson {geojson} --csv {table} --json {answer} --samples 10",
    )
    said = json.loads(answer.read_text())
    assert said["status"] == "reached"
    assert said["message"] in done.output
    # no log tells how the vehicle flies; the depth is stated
    assert said["message"].endswith("; assumed: 0.30 m/s")
    assert said["samples"]["count"] == 10
    assert len(table.read_text().splitlines()) == len(said["legs"]) + 1
    assert said["legs"][-1]["ellipse_major_m"] > 0.0
    assert (
        json.loads(geojson.read_text())["features"][0]["properties"]["duration_s"]
        == said["duration_s"]
    )
    ((time_ns, controls),) = decoded(out)["/plan/controls"]
    assert (time_ns, controls.status) == (10**18, "reached")
    assert (controls.duration, controls.message) == (
        pytest.approx(said["duration_s"]),
        said["message"],
    )


def recorded(path):
    """Return the metadata and the attached configuration of a plan's result."""
    with path.open("rb") as file:
        reader = make_reader(file)
        metadata = {record.name: dict(record.metadata) for record in reader.iter_metadata()}
        (config,) = [
            record.data.decode()
            for record in reader.iter_attachments()
            if record.name == "config.toml"
        ]
    return metadata, config


def test_its_files_are_whole_when_a_reader_of_its_table_stops_early(flow, tmp_path, monkeypatch):
    def closed(*_):
        raise BrokenPipeError

    monkeypatch.setattr("replay_kit.workflows.planning.outputs.print_plans", closed)
    out, answer = tmp_path / "plan.mcap", tmp_path / "plan.json"
    with pytest.raises(BrokenPipeError):
        run(f"{flow} {ASK} -o {out} --json {answer} --samples 0")
    assert json.loads(answer.read_text())["status"] == "reached"
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

    monkeypatch.setattr("replay_kit.workflows.planning.run.plan_mission", counted)
    with threadpool_limits(limits=3):
        run(f"{flow} {ASK} --samples 0 --config {config}", code=3)
    assert used == {threads}


def test_a_plan_says_what_it_was_made_of_and_can_be_made_again(flow, tmp_path):
    config, areas, out = (tmp_path / name for name in ("run.toml", "areas.geojson", "plan.mcap"))
    config.write_text(
        "[planner]\nmax_angle = 30.0\nlegs = 3\n[measurements]\nsurface_depth = 4.0\n"
    )
    far = [[150.0, -45.0], [150.1, -45.0], [150.1, -44.9], [150.0, -45.0]]
    areas.write_text(
        json.dumps(
            {
                "type": "Feature",
                "properties": {},
                "geometry": {"type": "Polygon", "coordinates": [far]},
            }
        )
    )
    run(
        f"{flow} {ASK} --config {config} --no-go {areas} --objective energy -o {out}",
    )
    metadata, settings = recorded(out)
    hashes = {"flow0": flow, "no_go": areas}
    expected = {
        name: f"{path.name} sha256:{hashlib.sha256(path.read_bytes()).hexdigest()}"
        for name, path in hashes.items()
    }
    assert metadata["replay_kit.inputs"] == expected
    assert metadata["replay_kit.options"]["start"] == "152.42,-40.0,0"
    assert metadata["replay_kit.options"]["goals"] == "152.52,-39.96,0"
    assert metadata["replay_kit.versions"]["replay-kit"] == __version__
    (tmp_path / "attached.toml").write_text(settings)
    attached = load_config(tmp_path / "attached.toml")
    assert (attached.planner.kind, attached.planner.objective, attached.planner.legs) == (
        "mission",
        "energy",
        3,
    )
    assert (
        attached.planner.max_angle,
        attached.planner.depth,
        attached.measurements.surface_depth,
    ) == (30.0, 390.0, 4.0)
    assert attached.planner.max_duration == MissionSettings().max_duration
    again = tmp_path / "again.mcap"
    places = ASK.partition(" --depth")[0]
    run(f"{flow} {places} --config {tmp_path}/attached.toml --no-go {areas} -o {again}")
    assert recorded(again)[1] == settings
    assert difference(out, again).same


@pytest.mark.full
def test_areas_and_bathymetry_are_kept_clear_of(flow, tmp_path):
    corners = [
        [152.46, -40.06],
        [152.475, -40.06],
        [152.475, -39.97],
        [152.46, -39.97],
        [152.46, -40.06],
    ]
    area = {
        "type": "Feature",
        "properties": {"name": "range"},
        "geometry": {"type": "Polygon", "coordinates": [corners]},
    }
    areas = tmp_path / "areas.geojson"
    areas.write_text(json.dumps({"type": "FeatureCollection", "features": [area]}))
    assert read_areas(areas)[0].name == "range"
    longitude, latitude = np.linspace(152.0, 153.0, 41), np.linspace(-40.4, -39.6, 33)
    bottom = np.where(
        (longitude[None] > 152.455) & (longitude[None] < 152.48) & (latitude[:, None] < -39.97),
        -100.0,
        -4000.0,
    )
    grid = xr.Dataset({"elevation": (("lat", "lon"), bottom)}, {"lon": longitude, "lat": latitude})
    grid.to_netcdf(tmp_path / "bottom.nc", engine="h5netcdf")
    read = read_bathymetry(tmp_path / "bottom.nc", uncertain_flow().grid)
    assert (read.depth.shape, read.depth.max()) == ((26, 39), 4000.0)
    free, past = (
        json.loads(run(f"{flow} {ASK} --json - {more}").stdout)
        for more in ("", f"--no-go {areas} --samples 5")
    )
    assert past["status"] == ("unsafe" if past["samples"]["safe"] < 0.9 else "reached")
    assert past["duration_s"] > free["duration_s"]
    assert (past["samples"]["safe"] == 1.0) == (past["samples"]["violations"] == {})
    assert past["samples"]["allowed"] is None
    config = tmp_path / "run.toml"
    config.write_text(f"[planner]\nlegs = {len(past['legs'])}\n")
    done = run(
        f"{flow} {ASK} --json - --no-go {areas} --samples 5 --risk 0.2 --config {config}",
        code=None,
    )
    wide = json.loads(done.stdout)
    assert wide["duration_s"] >= past["duration_s"] * (1.0 - 1e-4)
    violating = 1.0 - wide["samples"]["safe"]
    assert done.exit_code == (0 if violating <= 0.2 else 7)
    assert (violating == 0.0) == (wide["samples"]["violations"] == {})


@pytest.mark.full
def test_a_mooring_a_line_weights_and_waypoints_can_be_asked_for(flow, tmp_path):
    here = "--start=152.5,-40.0,0 --goal=152.5,-40.0,0 --depth 390 --json -"
    done = run(f"{flow} {here} --mooring 2000,4 --surfacings-only --samples 4")
    moored = json.loads(done.stdout)
    assert "simulated flights stay within 2000 m" in done.stderr
    assert moored["duration_s"] >= 4 * 3600.0 * (1.0 - 1e-9)
    assert (moored["status"] == "reached") == (moored["statistics"]["farthest_m"] <= 2000.0)
    assert moored["samples"]["miss_median_m"] >= 0.5 * moored["statistics"]["farthest_m"]
    places = tmp_path / "goto_l10.ma"
    lined = run(
        f"{flow} {ASK} --json - --line --line-weight 20 --objective time=1,energy=0.01 --waypoints {places}",
    )
    said = json.loads(lined.stdout)
    assert said["statistics"]["rms_m"] <= said["statistics"]["farthest_m"]
    assert said["waypoints"]["message"] in places.read_text()


def test_a_list_that_is_withheld_names_the_tolerance_that_helps(flow, tmp_path, monkeypatch):
    from replay_kit.workflows.planning import run as plans

    def crossing(flow, plan, request, tolerance, samples):
        few, odds = waypoints_of(flow, plan, request, tolerance, samples)
        at = Violation("land", 0.0, 1, 152.5, -40.0)
        return (few if (tolerance or 250.0) > 400.0 else replace(few, violation=at)), odds

    monkeypatch.setattr(plans, "waypoints_of", crossing)
    places = tmp_path / "places.csv"
    asked = f"{flow} {ASK} --samples 0 --waypoints {places}"
    withheld = run(asked, code=7)
    assert (withheld.exit_code, places.exists()) == (7, False)
    assert "the waypoints are not safe; --waypoint-tolerance 500 is safe" in withheld.output
    run(f"{asked} --waypoint-tolerance 500")
    assert places.exists()


def test_a_track_farther_from_its_line_than_the_width_does_not_reach_the_goal(flow, tmp_path):
    (tmp_path / "run.toml").write_text("[planner]\nlegs = 4\n")
    asked = f"{flow} {ASK} --line --samples 0 --config {tmp_path}/run.toml --json -"
    wide, narrow = (
        json.loads(run(f"{asked} {more}").stdout)
        for more in (f"-o {tmp_path / 'plan.mcap'}", "--line-width 30")
    )
    assert (wide["status"], narrow["status"]) == ("reached", "unreachable")
    assert 30.0 < narrow["statistics"]["farthest_m"] <= wide["statistics"]["farthest_m"]
    assert "farther than 30 m" in narrow["message"]
    options = recorded(tmp_path / "plan.mcap")[0]["replay_kit.options"]
    assert (options["line_weight"], options["line_width"]) == ("10.0", "2000.0")


@pytest.mark.parametrize(
    ("more", "code", "words"),
    [
        ("--samples 2", 2, "three or more"),
        ("--csv - --json -", 2, "standard output"),
        ("--risk 0.1 --samples 0", 2, "--samples"),
        ("--arrive 1.1", 2, "--arrive"),
        ("--time-limit 0", 2, "--time-limit"),
        ("--objective time=1,speed=2", 2, "--objective"),
        ("--mooring 500", 2, "RADIUS,HOURS"),
        ("--mooring 500,2 --line", 2, "--mooring: cannot be combined with --line"),
        ("--line --goal=152.5,-40,0", 2, "--goal: expected one with"),
        ("--mooring 500,2 --waypoints a.csv", 2, "--mooring: cannot be combined with --waypoints"),
        ("--waypoints a.txt", 2, "ends in one of"),
        ("--surfacings-only", 2, "expected --mooring"),
        ("--line --line-width inf", 2, "--line-width: expected a number above 0, got inf"),
        ("--mooring 500,2 --objective energy", 2, "combined with --objective"),
        ("--objective time=1,closest=0", 3, "a weight of 0"),
        ("--depth 4000", 3, "deepest level"),
        ("--max-depth 200", 3, "deeper than the vehicle's limit, 200 m"),
        ("--goal=170,-40,0", 3, "outside the forecast"),
        ("--no-go none.kml", 3, "none.kml: expected an input of"),
    ],
)
def test_what_it_refuses(flow, more, code, words):
    # an option that is given anew here is not given twice
    asked = ASK.partition(" --depth")[0] if "--depth" in more else ASK
    done = run(f"{flow} {asked} {more}", code=code)
    assert words in str(done.exception)
    assert getattr(done.exception, "exit_code", None) == code


def test_a_configuration_counts_here_too_and_options_win(flow, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text("[planner]\ndepth = 300.0\nmax_angle = 20.0\nsamples = 3\n")
    near = f"--start=152.42,-40.0,0 --goal=152.46,-40.0,0 --config {config} --json -"
    configured = json.loads(run(f"{flow} {near}").stdout)
    said = json.loads(run(f"{flow} {near} --depth 200 --samples 0").stdout)
    assert {leg["depth_m"] for leg in configured["legs"]} == {300.0}
    assert {leg["depth_m"] for leg in said["legs"]} == {200.0}
    assert max(leg["glide_angle_deg"] for leg in said["legs"]) <= 20.0 + 1e-6
    assert (configured["samples"]["count"], said["samples"]) == (3, None)


def test_a_plan_is_judged_by_a_hundred_samples_and_its_message_leads_with_the_odds(flow):
    done = run(f"{flow} {ASK} --json - --battery 10")
    said = json.loads(done.stdout)
    share = said["samples"]["reached"]
    assert said["samples"]["count"] == 100
    assert (share >= 0.9, said["samples"]["held"]) == (True, None)
    lead = f"{round(100.0 * share)} of 100 simulated flights come up within 250 m of the goal by "
    assert said["message"].startswith(lead)
    assert done.stderr.startswith(f"reached: {lead}")
    # 2001-09-09 01:46:40Z is where it begins
    hours = said["goals"][0]["met_s"] / 3600.0
    assert f"after {hours:.1f} h (2001-09-09 " in said["message"]
    assert (
        f"{said['energy_j'] / 1e3:,.0f} kJ, {said['energy_j'] / 1e5:.1f} % of 10 MJ" in done.stderr
    )
    doubtful = json.loads(run(f"{flow} {ASK} --json - --angles 15,16 --arrive 1").stdout)
    assert (doubtful["status"], doubtful["samples"]["reached"] < 1.0) == ("uncertain", True)
    assert "100 % are required" in doubtful["message"]


@pytest.mark.full
def test_a_risk_that_cannot_be_kept_ends_with_7_and_without_files(flow, tmp_path):
    # the goal lies 200 m from an area on either side
    areas, out, csv = tmp_path / "areas.geojson", tmp_path / "plan.mcap", tmp_path / "plan.csv"
    bands = [
        [[152.49, y], [152.55, y], [152.55, y + 0.03], [152.49, y + 0.03], [152.49, y]]
        for y in (-39.9918, -39.9582)
    ]
    areas.write_text(
        json.dumps(
            {
                "type": "Feature",
                "properties": {"name": "banks"},
                "geometry": {"type": "MultiPolygon", "coordinates": [[b] for b in bands]},
            }
        )
    )
    asked = f"{flow} {ASK} --no-go {areas} --risk 0.05 --csv {csv} -o {out} --time-limit 0.1"
    done = run(f"{asked} --json -", code=7)
    said = json.loads(done.stdout)
    assert done.exit_code == 7
    assert said["status"] == "unsafe"
    assert "the risk of 5 % cannot be kept: the least found is" in done.stderr
    assert f"from banks {100.0 * said['samples']['violations']['banks']:.0f} %" in done.stderr
    assert "the time limit of 0.1 s ended the search" in said["message"]
    assert not out.exists()
    assert not csv.exists()
    written = run(f"{asked} --write-unsafe", code=7)
    assert written.exit_code == 7
    assert out.exists()
    assert csv.exists()


def test_a_file_may_hold_what_is_asked_for(flow, tmp_path):
    config = tmp_path / "run.toml"
    config.write_text(
        "[planner]\ndepth = 390.0\n[plan]\nstart = '152.42,-40.0,0'\ngoal = ['152.52,-39.96,0']\narrive = 1\n"
    )
    found = [
        json.loads(run(f"{flow} {asked} --samples 0 --json -").stdout)
        for asked in (f"--config {config}", f"{ASK} --arrive 1")
    ]
    assert found[0]["legs"] == found[1]["legs"] != []
    for given, missing in (
        ("--goal=152.52,-39.96,0", "--start"),
        ("--start=152.42,-40,0", "--goal"),
    ):
        said = run(f"{flow} {given}", code=2).output
        assert f"{missing} is missing; expected " in said
    config.write_text("[plan]\nrisky = 0.1\n")
    assert "unknown key 'plan.risky'" in run(f"{flow} {ASK} --config {config}", code=2).output


def test_an_estimate_without_uncertainty_has_no_odds_and_says_so(flow, tmp_path):
    load(flow).mean_flow().save(tmp_path / "mean.nc")
    said = json.loads(run(f"{tmp_path / 'mean.nc'} {ASK} --json -").stdout)
    assert said["samples"] is None
    assert "states no uncertainty" in said["message"]
    for asked in ("--objective odds", "--risk 0.1"):
        refused = run(f"{tmp_path}/mean.nc {ASK} {asked}", code=3)
        assert refused.exit_code == 3
        assert asked.split()[0] in refused.output
        assert "so that it has no odds" in refused.output


@pytest.mark.full
def test_a_mission_for_the_odds_is_judged_in_other_samples_and_by_a_time(flow, tmp_path):
    narrow = "--angles 15,20 --json -"
    quickest, odds = (
        json.loads(run(f"{flow} {ASK} {narrow} {more}").stdout) for more in ("", "--objective odds")
    )
    assert odds["samples"]["reached"] >= quickest["samples"]["reached"]
    assert len(odds["legs"]) >= len(quickest["legs"])
    low, high = odds["samples"]["reached_interval"]
    assert low <= odds["samples"]["reached"] <= high
    assert f"90 % interval {100 * low:.0f} to {100 * high:.0f} %" in odds["message"]
    hours = quickest["duration_s"] / 3600.0
    late = json.loads(run(f"{flow} {ASK} {narrow} --arrive-by {0.5 * hours:.2f}h").stdout)
    assert (late["status"], late["samples"]["reached"]) == ("unreachable", 0.0)
    for given, why in (
        ("2001-09-09T00:00Z", "expected a time after the start at 2001-09-09 01:46:40Z"),
        ("0h", "expected a duration above 0"),
        ("2001-13-01", "'2001-13-01' is no time"),
    ):
        refused = run(f"{flow} {ASK} --arrive-by {given}", code=2)
        assert refused.exit_code == 2
        assert why in refused.output


def test_every_output_and_page_holds_a_plan_without_legs(flow, tmp_path):
    names = ("plan.mcap", "plan.geojson", "plan.csv", "plan.json", "places.csv")
    out, geojson, table, answer, places = (tmp_path / name for name in names)
    here = "--start=152.5,-40.0,0 --goal=152.5,-40.001,0 --depth 390 --risk 0.1 --samples 10"
    files = f"-o {out} --geojson {geojson} --csv {table} --json {answer} --waypoints {places}"
    done = run(f"{flow} {here} {files}")
    assert "reached: already there: the start is within 111.0 m of the goal" in done.output
    said = json.loads(answer.read_text())
    assert (said["status"], said["legs"], said["samples"], said["waypoints"]) == (
        "reached",
        [],
        None,
        None,
    )
    assert [
        feature["properties"]["name"] for feature in json.loads(geojson.read_text())["features"]
    ] == ["start", "goal 1"]
    assert table.read_text() == "leg\n"
    # a list of no places is no file for a glider
    assert not places.exists()
    assert "no waypoints are written: the plan has no legs" in done.output
    page, figure = tmp_path / "plan.html", tmp_path / "plan.png"
    for command in (
        f"report {out} -o {page}",
        f"plot {out} plan -o {figure}",
        f"verify {out} --inputs {flow.parent}",
    ):
        succeed(command)
    assert "No command: already there" in page.read_text()
    status = invoke(f"status {out} --json -")
    assert json.loads(status.stdout)["command"]["heading_deg"] is None
    assert "no command: already there" in " ".join(invoke(f"status {out}").stdout.split())
