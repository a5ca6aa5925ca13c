"""The study of plans that learn: one twin of each kind at its smallest, its figures, and that each of its checks can fail."""

from dataclasses import replace

import matplotlib.figure
import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.errors import ConfigError
from replay_kit.studies.jobs.progress import Advance
from replay_kit.studies.planning import STUDIES, learning
from replay_kit.studies.planning import learning_sea as sea
from replay_kit.studies.planning import learning_twins as twins
from replay_kit.studies.planning.job import PlanningJob
from replay_kit.studies.planning.learning import learning_calls, report_of
from replay_kit.studies.planning.learning_sea import DetourTwin, MapTwin, detour_twin, map_twin
from replay_kit.studies.planning.learning_twins import (
    SurveyTwin,
    Way,
    copies_of,
    survey_twins,
    without,
)
from replay_kit.studies.planning.world import build_world
from tests import synthetic
from tests.command import invoke

MEMBERS = synthetic.ensemble(
    n_members=6, shape=(17, 21), levels=np.array([5.0, 100.0, 250.0, 450.0])
)
CONFIG = RunConfig(estimator=EstimatorConfig(modes=10))


def test_copies_of_a_member_are_found_and_left_out_with_it():
    moved = np.roll(MEMBERS.velocity[2], (1, 2), axis=(2, 3))
    doubled = replace(MEMBERS, velocity=np.concatenate([MEMBERS.velocity, moved[None]]))
    assert copies_of(doubled, 2) == (2, 6)
    assert copies_of(doubled, 6) == (2, 6)
    assert copies_of(MEMBERS, 2) == (2,)
    (kept,), position = without((doubled,), 6)
    assert (kept.n_members, position) == (6, 5)
    np.testing.assert_array_equal(kept.velocity[position], moved)


def test_a_twin_is_flown_in_all_ways(monkeypatch):
    monkeypatch.setattr(twins, "_EDGE", 10e3)
    monkeypatch.setattr(twins, "_RANDOM", 1)
    (twin,) = survey_twins((MEMBERS,), CONFIG, 1, [0])
    assert set(twin.ways) == {"now", "waiting", "scouting", "planned", "closed ahead", "random"}
    for ways in twin.ways.values():
        for one in ways:
            assert np.isfinite([one.miss, one.predicted]).all()
    assert twin.ways["planned"][0].predicted < twin.ways["now"][0].predicted


def test_a_map_and_a_mission_have_their_twins(monkeypatch):
    monkeypatch.setattr(sea, "HALF", (25e3, 20e3))
    monkeypatch.setattr(sea, "PROFILES", 3)
    monkeypatch.setattr(sea, "_EDGE", 5e3)
    monkeypatch.setattr(sea, "_SAMPLES", 20)
    monkeypatch.setattr(sea, "_DISTANCE", (25e3, 35e3))
    mapped = map_twin(MEMBERS, CONFIG, 1, 0, True)
    assert mapped.planned < mapped.before
    assert mapped.hindsight <= mapped.mower
    flown = detour_twin(MEMBERS, CONFIG, 1, 0)
    assert flown.offered == (flown.detour if flown.pays else flown.straight)


def twin(miss, planned, inside=True):
    ways = {
        name: (Way(miss, miss, inside),)
        for name in ("now", "waiting", "scouting", "closed ahead", "random")
    }
    return SurveyTwin(0, {**ways, "planned": (Way(planned, planned, inside),)})


def found(surveys, maps=None, detours=None):
    maps = maps or [
        MapTwin(0, False, 0.1, 0.04, 0.04, 0.05, 0.045, 0.05),
        MapTwin(0, True, 0.1, 0.04, 0.04, 0.05, 0.045, 0.05),
    ]
    detours = detours or [DetourTwin(0, 50.0, 50.0, 55.0, -4.0, False)]
    return report_of(surveys, maps, detours)


def test_every_check_of_the_study_can_fail():
    good = found([twin(1000.0, 500.0)] * 9 + [twin(800.0, 400.0, False)])
    met = {one.what: one.met for one in good.criteria}
    assert [what for what, one in met.items() if not one] == [
        "90 % miss with the way ahead closed over waiting"
    ]
    bad = found(
        [twin(1000.0, 1200.0)],
        [MapTwin(0, half, 0.1, 0.06, 0.03, 0.05, 0.045, 0.05) for half in (False, True)],
        [DetourTwin(0, 50.0, 55.0, 55.0, 4.0, True)],
    )
    assert not any(one.met for one in bad.criteria)
    assert len(bad.criteria) == len(good.criteria) == 10
    assert "In 1 of 1" not in bad.findings[1]
    assert "offered in 1 of 1" in bad.findings[1]


def test_the_study_flies_each_truth_in_turn(monkeypatch):
    monkeypatch.setattr(
        learning,
        "survey_twins",
        lambda series, config, member, seeds: tuple(twin(1e3 + k, 500.0) for k in seeds),
    )
    monkeypatch.setattr(
        learning, "map_twin", lambda *_: MapTwin(0, _[-1], 0.1, 0.04, 0.04, 0.05, 0.045, 0.05)
    )
    monkeypatch.setattr(
        learning, "detour_twin", lambda *_: DetourTwin(0, 50.0, 50.0, 55.0, -4.0, False)
    )
    job = PlanningJob(("learn",), "1,3", surveys=5, maps=4, detours=3, seed=7)
    assert learning_calls(job) == 12
    world = build_world(MEMBERS, None, CONFIG.estimator, job, Advance())
    report = STUDIES["learn"].run(world)
    waiting = report.tables[1].column("waiting [m]")
    np.testing.assert_array_equal(np.sort(waiting), 1e3 + 7 + np.arange(5))
    assert [table.name for table in report.tables] == [
        "learn_surveys",
        "learn_twins",
        "learn_maps",
        "learn_missions",
    ]
    assert [row[1] for row in report.tables[2].rows] == ["no", "yes", "no", "yes"]
    figure = matplotlib.figure.Figure()
    report.pictures[0].draw(figure)
    assert len(figure.axes[0].get_legend().get_texts()) == 6
    with pytest.raises(ConfigError, match="leaves members out in turn"):
        STUDIES["learn"].run(
            replace(
                world,
                truths=(replace(world.truths[0], case=replace(world.truths[0].case, member=None)),),
            )
        )


def test_the_command_takes_it_by_name_alone(tmp_path):
    with pytest.raises(ConfigError, match="maps"):
        PlanningJob(("learn",), maps=0).check(STUDIES)
    synthetic.write_ocean(tmp_path, 4)
    ensemble, out = str(tmp_path / "ensemble.nc"), str(tmp_path / "out")
    refused = invoke(
        ["experiment", "planning", "--ensemble", ensemble, "--learn", "--study", "odds", "-o", out]
    )
    assert refused.exit_code == 2
    assert "--learn and --study" in refused.output
