"""Plans that learn from the command line: what they write, and what they refuse."""

import csv
import io
import json

import pytest

from tests.command import invoke, succeed
from tests.planners.learning.scenes import NOON, static, through_time
from tests.results.result_samples import metadata_of

START, THEN, GOAL = "--start=152.45,-39.66,0", "--then=152.62,-39.62,0", "--goal=152.8,-39.6,0"
MAP = "static.nc --objective map"
SMALL = "--depth 290 --samples 20 --profile-error 0.02"


@pytest.fixture(scope="module")
def flows(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learning")
    static().save(folder / "static.nc")
    through_time().save(folder / "changing.nc")
    static().mean_flow().save(folder / "sure.nc")
    return folder


def run(line, code=0):
    done = invoke(f"plan {line}")
    assert done.exit_code == code, done.output
    return done


@pytest.fixture(scope="module")
def survey(flows, tmp_path_factory):
    out = tmp_path_factory.mktemp("written")
    files = " ".join(f"--{end} {out}/plan.{end}" for end in ("json", "csv", "geojson"))
    ask = f"--objective learn {THEN} --blind 20 --survey 20 -o {out}/plan.mcap"
    return out, run(f"{flows / 'static.nc'} {START} {ask} {SMALL} {files}").output


def test_everything_a_survey_writes_agrees(survey):
    out, said = survey
    answer = json.loads((out / "plan.json").read_text())
    assert answer["message"] in said
    assert answer["message"].endswith("; assumed: 0.30 m/s")
    assert (answer["status"], answer["objective"], answer["unit"]) == ("uncertain", "survey", "m")
    names = [one["name"] for one in answer["candidates"]]
    assert names[:4] == ["leaving now", "waiting as long", "scouting ahead and back", "this survey"]
    assert answer["error_after"] < answer["error_before"]
    table = list(csv.DictReader(io.StringIO((out / "plan.csv").read_text())))
    assert [row["blind"] for row in table] == ["False"] * (len(table) - 1) + ["True"]
    features = json.loads((out / "plan.geojson").read_text())["features"]
    assert len(features) == len(table) + 1 == len(answer["legs"]) + 1
    # a static estimate is too sure, and says so
    assert any("does not change with time" in note for note in answer["notes"])
    records = metadata_of(out / "plan.mcap")
    assert json.loads(records["learning"]["candidates"]) == answer["candidates"]
    assert int(records["mission"]["start_time_ns"]) == NOON


def test_a_second_glider_is_told_of_the_first(survey, flows):
    out, _ = survey
    ask = f"--objective learn {THEN} --blind 20 --survey 20 --json -"
    alone = json.loads((out / "plan.json").read_text())
    second = json.loads(
        run(f"{flows / 'static.nc'} {START} {ask} {SMALL} --others {out / 'plan.mcap'}").stdout
    )
    assert second["error_before"] < 0.8 * alone["error_before"]
    assert second["error_after"] < alone["error_after"]


def test_the_report_shows_what_the_next_profile_is_worth(survey):
    out, _ = survey
    succeed(f"report {out}/plan.mcap -o {out}/report.html")
    page = (out / "report.html").read_text()
    assert "Value of the next profile" in page
    assert "waiting as long" in page


def test_a_map_is_answered(flows):
    box = "--objective map --box=152.3,-39.75,152.7,-39.45 --profiles 4 --dives 3 --json -"
    mapped = json.loads(run(f"{flows / 'changing.nc'} {START} {box} {SMALL}").stdout)
    assert (mapped["objective"], mapped["unit"], len(mapped["legs"])) == ("map", "m/s", 4)


@pytest.mark.parametrize(
    ("line", "words"),
    [
        (f"changing.nc {THEN} --blind 200", "--blind 200: expected survey and stretch to end"),
        (f"static.nc {THEN} --blind 20 --survey 3", "cannot return"),
        (f"sure.nc {THEN} --blind 20", "states no uncertainty"),
        (f"static.nc {THEN} --blind 20 --tolerance 1e6", "no uncertainty is left"),
        (f"static.nc {THEN}", "--objective learn: expected --then and --blind"),
        ("static.nc --blind 20", "--objective learn: expected --then and --blind"),
        (f"static.nc {THEN} --blind -1", "--blind: expected a number above 0"),
        (f"static.nc {THEN} --blind 20 {GOAL}", "--goal: expected a mission"),
        ("static.nc --survey 20", "--objective learn: expected --then and --blind"),
        ("static.nc --then=152.6,-39.6 --blind 20", "no whole places"),
        (f"static.nc {THEN} --blind 20 --horizon 72h", "--horizon: expected a mission"),
        (f"static.nc {THEN} --blind 20 --arrive 2", "--arrive: expected a share from 0 to 1"),
        (f"static.nc {THEN} --blind 20 --box=1,2,3,4", "expected --objective map"),
        (f"static.nc {THEN} --blind 20 --others absent.mcap", "absent.mcap"),
        (f"{MAP} --profiles 4", "--objective map: expected --box"),
        (f"{MAP} --box=152.3,-39.7,152.6,-39.5", "--objective map: expected --box"),
        (f"{MAP} --profiles 4 --box=152.3,-39.7,152.6", "--box: expected W,S,E,N[,DEPTHS]"),
        (f"{MAP} --profiles 4 --box=10,50,11,51", "outside of the estimate's region"),
        (f"{MAP} --profiles 4 --box=152.6,-39.7,152.3,-39.5", "west below east"),
        (f"{MAP} --profiles 4 --box=152.3,-39.7,152.6,-39.5 {GOAL}", "--goal: expected a mission"),
    ],
)
def test_what_is_to_be_measured_is_refused_with_one_clear_error(flows, line, words):
    objective = "" if "--objective" in line else "--objective learn"
    done = invoke(f"plan {flows}/{line} {START} {objective} --depth 290")
    assert done.exit_code not in (0, 1), done.output
    assert words in done.output
    assert "Traceback" not in done.output


def test_missions_take_none_of_the_options_of_plans_that_learn(flows):
    for more, words in (
        (f"{GOAL} --blind 20", "--objective learn or map"),
        ("", "--goal: expected LON,LAT,DEPTH"),
    ):
        done = invoke(f"plan {flows}/static.nc {START} {more}")
        assert done.exit_code == 2
        assert words in done.output
