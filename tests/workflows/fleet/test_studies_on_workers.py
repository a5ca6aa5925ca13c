"""Studies and fits whose calls workers make: the figures of one process, and progress that reaches its end."""

from dataclasses import astuple, replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.progress import called_by
from replay_kit.studies.paper.run import PaperJob, run_paper
from replay_kit.workflows.ensemble import fit_prior
from tests import synthetic
from tests.command import invoke
from tests.studies.results import final

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


def test_fit(cluster):
    here, there = both(cluster, lambda: fit_prior(MEMBERS, MODES, 3))
    assert here == there


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


def test_the_switch_is_on_every_command_of_the_studies():
    for command in ("experiment paper", "fit"):
        words = invoke([*command.split(), "--help-all"]).stdout.split()
        assert {"--scheduler", "--workers"} <= set(words)


def test_rows_of_arrays_arrive_as_they_were_sent(cluster):
    given = [(np.arange(10_000.0).reshape(100, 100).T, k) for k in range(3)]
    assert [value.tolist() for value in cluster.starmap(np.add, given)] == [
        (array + k).tolist() for array, k in given
    ]
