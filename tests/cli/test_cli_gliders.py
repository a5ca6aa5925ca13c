"""Several gliders planned together from the command line: what is written for each, and what is refused."""

import json

import pytest

from tests.command import invoke, succeed
from tests.planners.uncertain import static

BOTH = "--glider=sg1=152.45,-39.66,0 --glider=sg2=152.55,-39.62,0"
ONE = BOTH.split()[0]
NEAR, FAR = "--goal=152.5,-39.56,0", "--goal=152.6,-39.7,0"
SMALL = "--depth 290 --samples 20"


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    path = tmp_path_factory.mktemp("gliders") / "static.nc"
    static().save(path)
    return path


def run(line):
    return succeed(f"plan {line} {SMALL}")


@pytest.mark.full
def test_each_glider_has_a_goal_and_files_which_are_reproduced(flow, tmp_path):
    mcap, table, areas, answer = (
        tmp_path / f"plan.{kind}" for kind in ("mcap", "csv", "geojson", "json")
    )
    files = f"-o {mcap} --json {answer} --geojson {areas} --csv {table}"
    said = run(f"{flow} {BOTH} {NEAR} {FAR} --separation 1000 {files}").output
    told = json.loads(answer.read_text())
    assert sorted(told["goals"].values()) == [1, 2]
    assert told["goals_left"] == []
    (row,) = told["separation"]
    assert row["vehicles"] == ["sg1", "sg2"]
    assert row["kept"] is (row["least_distance_m"] >= 1000.0)
    assert "sg1 and sg2: at least" in said
    for name in ("sg1", "sg2"):
        assert told["vehicles"][name]["message"] in said
        assert len((tmp_path / f"plan-{name}.csv").read_text().splitlines()) > 1
        assert json.loads((tmp_path / f"plan-{name}.geojson").read_text())["features"]
        succeed(f"verify {tmp_path}/plan-{name}.mcap --inputs {flow.parent}")


def test_goals_too_many_and_too_few_are_named_and_one_may_be_a_glider_s_own(flow, tmp_path):
    lists = f"--waypoints {tmp_path}/list.csv"
    said = run(f"{flow} {BOTH} {NEAR} {FAR} --goal=152.4,-39.6,0 {lists}").output
    # a list of places for each, where it has a plan
    each = [(tmp_path / f"list-{name}.csv").read_text().splitlines() for name in ("sg1", "sg2")]
    assert all(len(rows) > 1 for rows in each)
    assert each[0][1:] != each[1][1:]
    assert "no glider goes there" in said
    told = json.loads(run(f"{flow} {BOTH} --goal=sg2=152.4,-39.6,0 --json -").stdout)
    assert told["goals"] == {"sg1": None, "sg2": 1}


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (f"{ONE} {NEAR}", "--glider: expected two gliders or more"),
        (f"{ONE} {ONE} {NEAR}", "another name for each"),
        (f"{ONE} --glider=../x=1,2,0 {NEAR}", "another name for each"),
        (f"{BOTH} --start=152.4,-39.6,0 {NEAR}", "--glider: cannot be combined with --start"),
        (f"{BOTH} --goal=sg3=152.4,-39.6,0", "got sg3"),
        (f"{BOTH} {NEAR} --separation -1", "--separation: expected a number above 0"),
        (f"--start=152.4,-39.6,0 {NEAR} --separation 500", "expected --glider too"),
        (f"{BOTH} {NEAR} --csv -", "expected files with --glider"),
        (f"{ONE} --glider=sg2=10,50,0 {NEAR}", "outside"),
    ],
)
def test_what_cannot_be_planned_together_is_refused_in_words(flow, more, words):
    done = invoke(f"plan {flow} {more} {SMALL}")
    assert done.exit_code in (2, 3)
    assert words in done.output.replace("\n", " ")
