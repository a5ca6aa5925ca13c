"""Faults of a forecast's file, by the mean currents of dives under the prior."""

import re
from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.run import EstimatorConfig
from replay_kit.core.geodesy import to_geographic
from replay_kit.core.observation import PathMean, Source
from replay_kit.estimator import build
from replay_kit.workflows.replay.consistency import _density, _under_prior, check_file
from tests import synthetic

SEA = synthetic.ensemble(n_members=8, shape=(6, 7))
NO_SKILL = replace(SEA, velocity=SEA.velocity[1:])
# members that agree with the first one, as those of a forecast with skill
SKILLED = replace(NO_SKILL, velocity=SEA.velocity[:1] + 0.2 * NO_SKILL.velocity)
CONFIG = EstimatorConfig(modes=12)


def dives(count=12):
    """Mean currents that the first member would give."""
    grid, rng, found = SEA.grid, np.random.default_rng(1), []
    for number in range(count):
        j, i = (int(rng.integers(1, size - 2)) for size in grid.east.shape)
        places = grid.east[j, i : i + 2], grid.north[j, i : i + 2]
        longitude, latitude = to_geographic(grid.projection, *places)
        velocity = SEA.velocity[0, :, 1, j, i : i + 2].mean(axis=1)
        times, depth = np.array([0, 1]), np.full(2, grid.levels[1])
        path = times, longitude, latitude, depth, np.full(2, 0.5)
        source = Source(0, "/dac", number, number)
        found.append(PathMean(number, *path, tuple(velocity.tolist()), 0.02, "dac", number, source))
    return found


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda u: -u, "both signs wrong"),
        (lambda u: 10.0 * u, "10 times too fast"),
        (lambda u: u, None),
    ],
)
def test_a_file_with_skill_is_warned_of_when_it_is_wrong(change, words):
    wrong = replace(SKILLED, velocity=np.ascontiguousarray(change(SKILLED.velocity)))
    found, _ = check_file(build([wrong], CONFIG), dives())
    assert len(found) == (words is not None)
    if words:
        assert (words in found[0].evidence, found[0].severity) == (True, "warning")


def test_what_a_file_without_skill_may_be_is_said_and_not_warned_of():
    found, (note,) = check_file(build([NO_SKILL], CONFIG), dives())
    assert not found
    assert note.startswith("cannot be known here: some faults of the forecast's file")
    # of those that these dives do not exclude
    assert min(int(each) for each in re.findall(r"e\^(-?\d+)", note)) >= -3


def test_few_dives_and_other_priors_say_nothing():
    assert check_file(build([SKILLED], CONFIG), dives(7)) == ((), ())
    assert check_file(object(), dives()) == ((), ())


def test_the_density_is_that_of_the_filter_one_by_one():
    # without an error that means near a node share
    config = CONFIG.model_copy(update={"representation_error_std": 0.0, "dropped_std": 0.0})
    estimator, means = build([SKILLED], config), dives()
    state, log = estimator.initial(), 0.0
    for mean in means:
        state, (done,) = estimator.assimilate(state, [mean])
        log += done.innovation.log_likelihood
    assert _density(*_under_prior(estimator, means))[0] == pytest.approx(log, rel=1e-6)
