"""Every estimator, baselines and one of another package included, by the four functions of the interface."""

from dataclasses import replace

import numpy as np
import pytest

from replay_kit.config.estimation import GatingConfig, TimeConfig
from replay_kit.core.errors import ConfigError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.observation import Flag, Reason
from replay_kit.estimator import Estimator, Stepped, build
from replay_kit.estimator.baselines import BASELINES, build_named
from replay_kit.estimator.interface import require_estimator
from replay_kit.estimator.update.screening import screened
from tests import synthetic
from tests.estimator.seas import CONFIG, GRID, SEA, profiles

DEPTH = np.array([10.0, 30.0, 90.0])


class Still(Estimator[int]):
    """Counts measurements, and takes the ensemble mean for the current."""

    def initial(self):
        return 0

    def assimilate(self, state, block):
        out = []
        for k, event in enumerate(block, state):
            ((one,), _) = screened([event], GRID)
            out.append(Stepped(event, k, k + 1, one.unused(0)))
        return state + len(block), out

    def flow(self, state):
        estimator = build([SEA], CONFIG)
        return estimator.flow(estimator.initial()).mean_flow()


def built(name):
    if name in BASELINES:
        return build_named(SEA, CONFIG.model_copy(update={"name": name}))
    time = TimeConfig(scale=86_400.0) if name == "through time" else None
    preset = "paper" if name == "paper" else "default"
    return build([SEA], CONFIG.model_copy(update={"preset": preset}), GatingConfig(), time)


OWN = ["static", "through time", "paper", *BASELINES]


@pytest.fixture(scope="module", params=OWN)
def estimator(request):
    return built(request.param)


def profile(place=(1e3, 2e3), time_ns=10, level=0.1):
    return synthetic.profile(GRID, *place, DEPTH, np.full((3, 2), level), time_ns=time_ns)


def test_states_do_not_change_and_a_block_is_its_measurements(estimator):
    log = [profile(), profile((-4e3, 1e3), 20), profile((5e3, -3e3), 30)]
    start = state = estimator.initial()
    before, innovations = estimator.flow(start).latent.copy(), []
    for k, given in enumerate(log):
        assert estimator.usable(given)
        off = estimator.innovation(state, given)
        state, (step,) = estimator.assimilate(state, [given])
        assert step.innovation.accepted
        if k:
            np.testing.assert_allclose(off, step.innovation.innovation, atol=1e-9)
        innovations.append(step.innovation)
    same, steps = estimator.assimilate(start, log)
    flow, other = (estimator.flow(each) for each in (same, state))
    assert isinstance(flow, FlowEstimate)
    np.testing.assert_allclose(flow.latent, other.latent, atol=1e-9)
    np.testing.assert_allclose(
        steps[-1].innovation.innovation, innovations[-1].innovation, atol=1e-9
    )
    np.testing.assert_array_equal(estimator.flow(start).latent, before)
    for time_ns in (5, 30):
        again = estimator.flow(estimator.predict(state, time_ns))
        np.testing.assert_array_equal(again.latent, other.latent)
    assert all(isinstance(note, str) for note in [*estimator.notes(), *estimator.remarks(state)])
    assert estimator.assimilate(state, []) == (state, [])


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"depth": np.array([400.0, 500.0, 600.0])}, Reason.BELOW_GRID),
        ({"longitude": 160.0}, Reason.OUTSIDE_REGION),
        ({"flags": np.full(3, Flag.MISSING, np.int8)}, Reason.NONE),
    ],
)
def test_an_unusable_profile_leaves_every_estimate_as_it_is(estimator, changes, reason):
    dry, state = replace(profile(), **changes), estimator.initial()
    after, (step,) = estimator.assimilate(state, [dry])
    assert after is state
    assert (step.innovation.accepted, step.innovation.dof) == (False, 0)
    assert step.innovation.reasons.tolist() == [reason] * 3
    assert not estimator.usable(dry)
    assert np.isnan(estimator.innovation(state, dry)).all()
    assert np.isnan(step.innovation.log_likelihood)


def test_an_innovation_is_measured_minus_predicted_before_and_after():
    estimator, given = built("static"), profiles(1)[0]
    state, (step,) = estimator.assimilate(estimator.initial(), [given])
    here = np.array(GRID.nodes.mean(axis=0))
    own = synthetic.profile(
        GRID, *here, given.depth, given.velocity, 0.05, time_ns=state.time_ns + 1
    )
    after, (step,) = estimator.assimilate(state, [own])
    used, said = given.depth <= GRID.levels[-1], step.innovation
    for name, each in (
        ("innovation", state),
        ("residual", after),
        ("prior_innovation", estimator.initial()),
    ):
        flow = replace(estimator.flow(each), unknowns=None)
        off = given.velocity - flow.velocity(*here, given.depth)
        np.testing.assert_allclose(getattr(said, name)[used], off[used], atol=1e-9)
    assert np.isnan(said.innovation[~used]).all()
    stated = estimator.flow(state).standard_error(*here, given.depth[used])
    assert np.all(said.innovation_std[used] >= stated)


def test_one_of_another_package_needs_the_four_functions_alone():
    own = Still()
    state, steps = own.assimilate(own.initial(), profiles(3))
    assert (state, len(steps), own.predict(state, 5), own.notes()) == (3, 3, 3, [])
    given = profiles(1)[0]
    expected = built("static").innovation(built("static").initial(), given)
    np.testing.assert_allclose(own.innovation(0, given), expected, atol=1e-9)
    assert own.usable(given)
    assert require_estimator(own, "mine") is own
    with pytest.raises(ConfigError, match="mine: expected an Estimator, got int without initial"):
        require_estimator(3, "mine")
