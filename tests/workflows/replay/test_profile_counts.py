"""Sums over profiles: a group's, which states its totals, are those of its profiles one by one."""

from dataclasses import astuple, replace

import numpy as np

from replay_kit.core.observation import GroupTotals
from replay_kit.estimator.update.screening import screened
from replay_kit.workflows.replay.stages.counts import Sums
from tests import synthetic

GRID = synthetic.ensemble(n_members=2).grid
PROFILES = synthetic.random_profiles(GRID, 5)


def test_a_group_counts_as_its_profiles_do():
    rng, names = np.random.default_rng(0), ("innovation", "residual", "prior_innovation")
    one_by_one, dive_innovations, members = Sums(bins=3), [], []
    for profile in PROFILES:
        shape = (profile.depth.size, 2)
        values = {name: rng.standard_normal(shape) for name in names}
        blank = screened([profile], GRID)[0][0].unused(0)
        told = {"nis": float(rng.random()), "dof": 2 * profile.depth.size, "accepted": True}
        members.append(replace(blank, **told, **values))
        dive_innovations.append(rng.standard_normal(shape))
        one_by_one = one_by_one.with_profile(members[-1], dive_innovations[-1])
    squares = [float(sum(np.sum(getattr(each, name) ** 2) for each in members)) for name in names]
    totals = GroupTotals(sum(profile.depth.size for profile in PROFILES), *squares)
    nis, dof = sum(each.nis for each in members), sum(each.dof for each in members)
    group = replace(members[0], nis=nis, dof=dof, profiles=len(members), totals=totals)
    total = Sums(bins=3).with_profile(group, np.concatenate(dive_innovations))
    np.testing.assert_allclose(astuple(total), astuple(one_by_one), rtol=1e-12)
    assert total.profiles == 5
    assert total.rms(total.before) == np.sqrt(total.before / dof)
    assert total.nis_per_dof == nis / dof
    assert np.isnan(Sums().rms(0.0))
