"""Where an ADCP looks, by its shears: on a made dive either way, and on real ones."""

import numpy as np
import pytest

from replay_kit.logs.netcdf.adcp import agreement, orientation

DISTANCE = np.arange(2.1, 32.0, 2.0)


def _dive(sign, noise):
    """Return velocities and depths of a dive through a sheared current, each ping with the motion of the glider."""
    rng, descent = np.random.default_rng(3), np.arange(40.0, 200.0, 6.0)
    depth = np.concatenate([descent, 240.0 - descent])
    cells = depth[:, None] + sign * DISTANCE
    current = np.stack([0.3 * np.sin(cells / 25.0), 0.2 * np.cos(cells / 40.0)], axis=-1)
    motion = rng.normal(0.0, 0.3, (depth.size, 1, 2))
    return current + motion + rng.normal(0.0, noise, current.shape), depth


def _twin(shear, depth):
    """The variance of shears within bins of 5 m, one by one."""
    bins = {}
    for value, at in zip(shear.reshape(-1, 2), depth.ravel(), strict=True):
        bins.setdefault(int(at // 5.0) if at > 0.0 else None, []).append(value)
    kept = [np.array(bins[each]) for each in bins.keys() - {None} if len(bins[each]) >= 3]
    squares = sum(((values - values.mean(axis=0)) ** 2).sum() for values in kept)
    return squares / sum(len(values) - 1 for values in kept)


@pytest.mark.parametrize(("sign", "looks"), [(-1.0, "up"), (1.0, "down")])
def test_shears_tell_where_it_looks(sign, looks):
    velocity, depth = _dive(sign, 0.02)
    notes: list[str] = []
    assert orientation(velocity, depth, DISTANCE, notes) == looks
    shear, middle = velocity[:, 5:] - velocity[:, :-5], 0.5 * (DISTANCE[5:] + DISTANCE[:-5])
    ratio = _twin(shear, depth[:, None] + middle) / _twin(shear, depth[:, None] - middle)
    assert agreement(velocity, depth, DISTANCE) == pytest.approx(ratio, rel=1e-10)
    assert f"looks {looks} by its shears: variance {max(ratio, 1 / ratio):.2f} times" in notes[0]


@pytest.mark.parametrize("cells", [3, 5, 6, 15])
def test_where_shears_do_not_tell_up_is_taken(cells):
    velocity, depth = np.full((4, cells, 2), 0.25), np.array([10.0, 100.0, np.nan, 300.0])
    notes: list[str] = []
    assert orientation(velocity, depth, DISTANCE[:cells], notes) == "up"
    assert "ADCP: assumed to look up" in notes[0]


def test_a_ratio_near_one_by_chance_decides_nothing():
    """Shears that are noise alone have ratios off 1 by chance; of 40 dives at most 4, twice what two standard errors let through."""
    descent, decided = np.linspace(20.0, 400.0, 30), 0
    depth = np.concatenate([descent, descent[::-1]])
    for seed in range(40):
        velocity = np.random.default_rng(seed).normal(0.0, 0.05, (depth.size, DISTANCE.size, 2))
        notes: list[str] = []
        orientation(velocity, depth, DISTANCE, notes)
        decided += "looks" in notes[0]
        assert agreement(velocity, depth, DISTANCE) != 1.0
    assert decided <= 4
