"""Several gliders planned together from the command line: what is written for each, and what is refused."""

import json

import pytest

from tests.command import invoke
from tests.planners.learning.scenes import static

SG1, SG2 = "--glider=sg1=152.45,-39.66,0", "--glider=sg2=152.55,-39.62,0"
NEAR, FAR = "--goal=152.5,-39.56,0", "--goal=152.6,-39.7,0"
SMALL = ("--depth", "290", "--samples", "20")
BOX = ("--objective", "map", "--box=152.35,-39.75,152.65,-39.5", "--profiles", "3")


@pytest.fixture(scope="module")
def flow(tmp_path_factory):
    path = tmp_path_factory.mktemp("gliders") / "static.nc"
    static().save(path)
    return path


def run(*arguments, code=0):
    done = invoke(["plan", *map(str, arguments)])
    assert done.exit_code == code, done.output
    return done


def test_each_glider_has_a_goal_and_files_which_are_reproduced(flow, tmp_path):
    files = ("-o", tmp_path / "plan.mcap", "--json", tmp_path / "plan.json")
    files += ("--geojson", tmp_path / "plan.geojson", "--csv", tmp_path / "plan.csv")
    said = run(flow, SG1, SG2, NEAR, FAR, "--separation", "1000", *SMALL, *files).output
    answer = json.loads((tmp_path / "plan.json").read_text())
    assert sorted(answer["goals"].values()) == [1, 2]
    assert answer["goals_left"] == []
    (row,) = answer["separation"]
    assert row["vehicles"] == ["sg1", "sg2"]
    assert row["kept"] is (row["least_distance_m"] >= 1000.0)
    assert "sg1 and sg2: at least" in said
    for name in ("sg1", "sg2"):
        assert answer["vehicles"][name]["message"] in said
        assert len((tmp_path / f"plan-{name}.csv").read_text().splitlines()) > 1
        assert json.loads((tmp_path / f"plan-{name}.geojson").read_text())["features"]
        verified = invoke(
            ["verify", str(tmp_path / f"plan-{name}.mcap"), "--inputs", str(flow.parent)]
        )
        assert verified.exit_code == 0, verified.output


def test_goals_too_many_and_too_few_are_named_and_one_may_be_a_glider_s_own(flow):
    said = run(flow, SG1, SG2, NEAR, FAR, "--goal=152.4,-39.6,0", *SMALL).output
    assert "no glider goes there" in said
    asked = ("--goal=sg2=152.4,-39.6,0", "--json", "-")
    answer = json.loads(run(flow, SG1, SG2, *asked, *SMALL).stdout)
    assert answer["goals"] == {"sg1": None, "sg2": 1}


def test_a_box_is_surveyed_by_all(flow, tmp_path):
    files = ("-o", tmp_path / "map.mcap", "--json", tmp_path / "map.json")
    said = run(flow, SG1, SG2, *BOX, *SMALL, *files).output
    answer = json.loads((tmp_path / "map.json").read_text())
    first, second = (answer["vehicles"][name] for name in ("sg1", "sg2"))
    assert first["error_after"] == second["error_after"] < first["error_before"]
    assert 0.0 < answer["share_of_bound"] < 1.0
    assert "each for itself" in said
    assert (tmp_path / "map-sg2.mcap").exists()


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ((SG1, NEAR), "--glider: expected two gliders or more"),
        ((SG1, SG1, NEAR), "another name for each"),
        ((SG1, "--glider=../x=1,2,0", NEAR), "another name for each"),
        ((SG1, SG2, "--start=152.4,-39.6,0", NEAR), "--start: expected no --glider"),
        ((SG1, SG2, "--goal=sg3=152.4,-39.6,0"), "got sg3"),
        ((SG1, SG2, NEAR, "--separation", "-1"), "--separation: expected a number above 0"),
        (("--start=152.4,-39.6,0", NEAR, "--separation", "500"), "expected --glider beside it"),
        ((SG1, SG2, NEAR, "--waypoints", "list.csv"), "plan each glider alone"),
        ((SG1, SG2, NEAR, "--csv", "-"), "expected files with --glider"),
        ((SG1, SG2, *BOX, "--separation", "500"), "surveys are not kept apart"),
        ((SG1, "--glider=sg2=10,50,0", NEAR), "outside"),
    ],
)
def test_what_cannot_be_planned_together_is_refused_in_words(flow, more, words):
    done = invoke(["plan", str(flow), *more, *SMALL])
    assert done.exit_code in (2, 3)
    assert words in done.output.replace("\n", " ")
