"""``status`` of several results, and ``fleet --place-ensemble``."""

import json

import numpy as np
import pytest

import replay_kit as rk
from replay_kit.config.run import load_config
from tests import synthetic
from tests.command import invoke

SETTINGS = {
    "estimator": {"modes": 6, "sample_share": 0.5, "shift_distance": 0.0},
    "output": {"interval": 1e6},
}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    profile = rk.Observation.profile(
        "2018-11-16T06:00:00Z", 152.2, -39.8, [10.0, 60.0], [0.1, 0.1], [0.0, 0.0], 0.05
    )
    forecast = synthetic.dataset(n_members=6).assign_coords(time=np.datetime64("2018-11-16", "ns"))
    for name in "ab":
        rk.replay(profile, forecast, out=folder / f"{name}.mcap", settings=SETTINGS)
    return [str(folder / f"{name}.mcap") for name in "ab"]


def test_several_results_are_shown_one_after_the_other_and_a_page_is_of_one(results, tmp_path):
    said = [invoke(f"status {each}").stdout for each in results]
    assert invoke(["status", *results]).stdout == "".join(said)
    both, first = (
        json.loads(invoke(f"status {' '.join(each)} -q --json -").stdout)
        for each in (results, results[:1])
    )
    assert [len(each) for each in both["results"]] == [len(first) - 1] * 2
    done = invoke(f"status {' '.join(results)} --html {tmp_path}/a.html")
    assert (done.exit_code, "--html: expected one result" in done.output) == (2, True)


def test_a_fleet_may_move_each_ensemble_to_its_log(monkeypatch, tmp_path):
    asked = []

    def missions_of(table, *rest):
        asked.append(table.all.settings)
        raise KeyboardInterrupt

    monkeypatch.setattr("replay_kit.workflows.fleet.missions.missions_of", missions_of)
    for words in ("", "--place-ensemble"):
        with pytest.raises(KeyboardInterrupt):
            invoke(f"fleet *.mcap --ensemble a.nc -o {tmp_path}/out {words}")
    assert asked == [{}, {"forecast": {"place": True}}]
    assert load_config(None, asked[1]).forecast.place
