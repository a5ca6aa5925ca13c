"""Studies and fits whose calls workers make: the figures of one process, and progress that reaches its end."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from replay_kit.config.estimation import TimeConfig
from replay_kit.config.run import EstimatorConfig, RunConfig
from replay_kit.core.grid import Ensemble
from replay_kit.core.progress import called_by
from replay_kit.estimator.evolving.build import build_evolving
from replay_kit.studies.bench.dives import DiveJob, run_dives
from replay_kit.studies.bench.faults import FaultJob, run_faults
from replay_kit.studies.bench.missions import mission_of
from replay_kit.studies.bench.plans import PlanJob, run_plans
from replay_kit.studies.bench.surveys import SurveyJob, run_surveys
from replay_kit.studies.paper.run import PaperJob, run_paper
from replay_kit.studies.twins.make import Twin, make_twin
from replay_kit.workflows.ensemble import fit_prior
from tests import synthetic
from tests.command import invoke
from tests.studies.results import bench, final

MEMBERS = synthetic.ensemble(n_members=6, shape=(8, 9))
MODES = EstimatorConfig(modes=6, sample_share=0.6)


def both(cluster, study):
    """Return what a study gives here, and what it gives with workers."""
    here = study()
    with called_by(cluster.starmap):
        return here, study()


def alike(cells, others, within=None):
    """Return whether values are the same: numbers but for the last digits, which depend on where in memory an array lies."""
    assert len(cells) == len(others)
    return all(
        one == pytest.approx(other, abs=within, nan_ok=True)
        for one, other in zip(cells, others, strict=True)
    )


def test_bench(cluster):
    job, told = (
        SurveyJob(leave_out="0,3", pings=(2, 4), seeds=2, methods=("default", "etkf", "nearest")),
        [],
    )
    here, there = both(
        cluster,
        lambda: list(run_surveys(MEMBERS, None, MODES, job, lambda *step: told.append(step[:2]))),
    )
    # undefined figures are unequal to themselves
    assert repr(here) == repr(there)
    # here each ping is a step, of workers what a call has done
    assert told == [*((n, 48) for n in range(1, 49)), *((n, 48) for n in range(8, 49, 8))]


def test_fit(cluster):
    here, there = both(cluster, lambda: fit_prior(MEMBERS, MODES, 3))
    assert here == there


@pytest.mark.full
def test_faults(cluster):
    slow = replace(MEMBERS, velocity=0.3 * MEMBERS.velocity)
    job = FaultJob("1,3", tasks=("outliers",), pings=6, days=2.0, evaluations=2)
    config = RunConfig(estimator=MODES)
    here, there = both(cluster, lambda: list(run_faults((slow,), config, job)))
    assert repr(here) == repr(there)


def test_dives(cluster, tmp_path):
    truth = Ensemble(MEMBERS.grid, MEMBERS.velocity[:1], None, "truth")
    make_twin(truth, Twin("glider", 12, 0.05, 3, interval_s=1200.0), tmp_path / "glider.mcap")
    mission = mission_of([tmp_path / "glider.mcap"], RunConfig())
    estimator = build_evolving((MEMBERS,), MODES, TimeConfig())
    job = DiveJob(("next-dive", "profile"), first=1)
    here, there = both(cluster, lambda: list(run_dives([mission], estimator, job)))
    assert repr(here) == repr(there)


@pytest.mark.full
def test_paper(cluster):
    job = PaperJob(leave_out="0,2", most_modes=4, plan_modes=4, pings=(3,), pairs=1)
    here, there = both(cluster, lambda: final(run_paper(MEMBERS, None, MODES, job)))
    # of a glide its optimiser knows the miss to centimetres
    for name, within in (("table1", None), ("table2", None), ("table3", 0.1)):
        one, other = getattr(here, name), getattr(there, name)
        cells, those = (
            [value for row in rows for value in astuple(replace(row, seconds=0.0))]
            for rows in (one, other)
        )
        assert alike(cells, those, within)


@pytest.mark.full
def test_plans(cluster):
    slow = replace(MEMBERS, velocity=0.3 * MEMBERS.velocity)
    job = PlanJob("1,3", 2, 6, legs=2, fresh=10)
    here, there = both(cluster, lambda: list(run_plans(slow, None, MODES, job)))
    assert len(here) == 2
    assert here == there


def test_the_switch_is_on_every_command_of_the_studies_and_gives_the_same_table(
    scheduler, table, tmp_path
):
    words = f"--ensemble {table.parent}/ensemble.nc --leave-out 1 --pings 2 --seeds 1 --methods nearest,ensemble_mean --json"
    assert bench(f"{words} {tmp_path}/here.json").exit_code == 0
    done = bench(f"{words} {tmp_path}/there.json --scheduler {scheduler}")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "here.json").read_bytes() == (tmp_path / "there.json").read_bytes()
    for command in (
        "bench",
        "experiment paper",
        "fit",
    ):
        assert {"--scheduler", "--workers"} <= set(
            invoke([*command.split(), "--help-all"]).stdout.split()
        )


def test_rows_of_arrays_arrive_as_they_were_sent(cluster):
    given = [(np.arange(10_000.0).reshape(100, 100).T, k) for k in range(3)]
    assert [value.tolist() for value in cluster.starmap(np.add, given)] == [
        (array + k).tolist() for array, k in given
    ]
