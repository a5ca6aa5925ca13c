"""Pairs of two measurements of one vector: profiles against mean currents, and against the platform's motion.

* ``current``: the mean of a dive's profiles along its path, and its mean current. Profiles are averaged in 10 m depth cells; a dive covered
  by less than three quarters makes no pair.
* ``vehicle``: both relative to the vehicle, dominated by its motion through water, which shows compass errors also in weak currents. A dive
  is one pair, as its mean current has one error.
* ``blocks``: the same for profiles relative to a platform of unknown velocity, in blocks of half an hour, with its velocity from dead
  reckoning.
* ``motion``: changes of the relative velocity and of minus the platform's velocity between pings; the current changes less than both.
* ``track``: the platform's velocity stated by an instrument, and that from the pings' positions.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from replay_kit.core.arrays import Array, Times
from replay_kit.measurements.checks.causes import (
    CURRENT,
    HOUR_NS,
    KNOWN,
    LIKELY,
    MEANS,
    OF_DIVES,
    OF_MOTION,
    OF_SOURCES,
    RECKONED,
    SCALE,
    cause_of,
    finding_of,
    rotation_finding,
)
from replay_kit.measurements.checks.fold import (
    Context,
    Found,
    Judged,
    Memory,
    Rows,
    displacements,
    history,
    latest_rows,
    ordered_sum,
    spaced,
)
from replay_kit.measurements.checks.likelihood import (
    CAUSES,
    KINDS,
    TURNED,
    Complex,
    causes,
    explanation,
    odds,
    tell_directions,
)
from replay_kit.measurements.checks.profile import repairable

_SOURCES = {
    "current": CURRENT,
    "vehicle": OF_DIVES,
    "blocks": OF_MOTION,
    "motionpair": OF_MOTION,
    "trackpair": OF_MOTION,
}
# Pairs that are remembered: what is correlated over a long log is not more evidence without end. After how many more they are judged.
_MOST, _JUDGED_EACH = 128, 4
# Pings that are remembered for the mean currents to come, at least so many s apart; s, of a block of them, between positions that give a
# velocity at most and at least.
_PINGS, _APART, _BLOCK, _LONGEST, _SHORTEST = 1024, 10.0, 1800.0, 3600.0, 60.0
# m from the first bin, in which the water is that about the instrument; from a path within which profiles cover it; of it the share.
_NEAR, _COVERED, _LEAST_COVERED = 100.0, 100.0, 0.75
# Columns of pings that are remembered.
_COLUMNS = ("time", "longitude", "latitude", "near", "moves", "relative", "dive")
# m, and number, of the cells of depth in which a dive's profiles are averaged; dives of which they are remembered.
_CELL, _CELLS, _DIVES = 10.0, 700, 2
# Mean currents in a row, equal to the last digit, which no two dives have.
_EQUAL = 3
_CONTRADICTED = {
    "motion": "changes of the measured velocity follow those of the platform's velocity",
    "track": "the platform's stated velocity contradicts that of its positions",
}


def _near_means(pings: Rows) -> Rows:
    """Return pings with a good or repairable bin, reduced to their bins near the instrument.

    Added columns: ``near``, their mean velocity, and ``moves``, the platform velocity added to it, NaN if not stated, both east + i north,
    shape (n,) [m/s]; ``relative``, whether it is relative to a platform of unknown velocity.
    """
    good = repairable(pings)
    pings, good = pings.take(good.any(axis=1)), good[good.any(axis=1)]
    nearest = pings["depth"][np.arange(len(good)), np.argmax(good, axis=1)]
    close = good & (np.abs(pings["depth"] - nearest[:, None]) <= _NEAR)
    each = (ordered_sum(np.where(close, one, 0.0)) for one in np.moveaxis(pings["velocity"], 2, 0))
    mean = np.column_stack([*each]) / close.sum(axis=1)[:, None]
    return pings.having(
        near=mean @ (1.0, 1j),
        moves=pings["platform"] @ (1.0, 1j),
        relative=~np.isfinite(pings["common_std"]),
    )


def _ways(pings: Rows) -> Complex:
    """Return the velocities over ground between consecutive pings, shape (n - 1,) [m/s]; NaN for zero or more than one hour."""
    way, seconds = displacements(pings)
    known = (seconds > 0.0) & (seconds <= _LONGEST)
    return np.where(known, way / np.where(known, seconds, 1.0), np.nan)


def _pairs_of(a: Complex, b: Complex, weight: float, time: Times) -> Array:
    """Return pairs of vectors as rows of shape (n, 6): east and north of both, weight, hours since 1970."""
    columns = [a.real, a.imag, b.real, b.imag, np.full(len(a), weight), time / HOUR_NS]
    return np.column_stack(columns)


def _check_motion(memory: Memory, near: Rows, through_water: bool) -> Judged:
    """Check changes of motion, and the stated velocity of the platform against that from its positions.

    Args:
        memory: See ``against_references``.
        near: New pings.
        through_water: Whether dead reckoning assumes no current.
    """
    # closer positions have too few digits for a velocity
    chain, after = history(memory, near, _COLUMNS, _SHORTEST, 1, "chain")
    start, end = chain.take(slice(0, -1)), chain.take(slice(1, None))
    over_ground = _ways(chain)
    stated = ~np.isnan(start["moves"])
    platform = np.where(stated, start["moves"], over_ground)
    known = ~np.isnan(over_ground)
    absolute = known & ~start["relative"] & (not through_water)
    relative = np.where(absolute, start["near"] - platform, np.nan)
    before = memory.get("before", np.full((1, 2), np.nan + 0j))
    motion = np.concatenate([before, np.column_stack([relative, -platform])])
    after, found = {**after, "before": motion[-1:]}, list[Found]()
    changes = np.diff(motion, axis=0).T
    for name, (a, b), told in (
        ("motion", changes, ~np.isnan(changes[0])),
        ("track", (platform, over_ground), known & stated),
    ):
        # neighbouring changes share a ping
        new = end.having(pair=_pairs_of(a, b, 0.5, start["time"])).take(told)
        pairs, held = history(memory, new, ("time", "pair"), 0.0, _MOST, name)
        after |= held
        for event in pairs.due(_JUDGED_EACH):
            found += _motion_findings(pairs.until(event, _MOST), name)
    return after, found


def _motion_findings(rows: Rows, name: str) -> list[Found]:
    """Return the finding of a rotation from pairs of motion, or of a scale of the stated velocity as the likeliest cause."""
    pairs = rows["pair"]
    if turned := explanation(pairs, OF_MOTION, TURNED):
        return rotation_finding(rows, turned, _CONTRADICTED[name])
    if name == "motion" or not (scale := explanation(pairs, OF_MOTION, ("scale",))):
        return []
    # positions may lack the current
    cause, share = odds(causes(pairs, OF_MOTION, KINDS))[0]
    if cause != CAUSES["scale"] or share < LIKELY:
        return []
    return finding_of(
        rows,
        scale,
        SCALE,
        f"against its positions the platform's stated velocity looks {scale.names}",
        "a wrong unit or scale of the platform's velocity, and of the profiles that it is in",
        "state measurements.velocity_unit, or correct the platform's velocity",
        OF_SOURCES,
    )


def _dives(memory: Memory, pings: Rows) -> Memory:
    """Return the sums of the good bins of the latest dives in depth cells.

    Args:
        memory: ``dives`` (2,), numbers of the latest dives, 0 for none, the odd one last; ``sums`` (2, 700, 4) by dive and cell: number of
            bins, east, north [m/s] and depth [m].
        pings: Pings of one instrument, in order.
    """
    absolute = np.isfinite(pings["common_std"]) & (pings["dive"] > 0)
    pings = pings.take(absolute)
    rows, bins = np.nonzero(repairable(pings))
    depth, dive = pings["depth"][rows, bins], pings["dive"][rows]
    old = memory.get("dives", np.zeros(_DIVES, np.int64))
    dives = old.copy()
    dives[dive % _DIVES] = dive
    sums = memory.get("sums", np.zeros((_DIVES, _CELLS, 4))) * (dives == old)[:, None, None]
    cell = np.clip(depth / _CELL, 0, _CELLS - 1).astype(np.int64)
    values = np.column_stack([np.ones(len(cell)), pings["velocity"][rows, bins], depth])
    # one bin after the other, so that sums do not depend on where blocks end
    values *= (dives[dive % _DIVES] == dive)[:, None]
    np.add.at(sums, (dive % _DIVES, cell), values)
    return {"dives": dives, "sums": sums}


def _along(memory: Memory, near: Rows, mean: Rows) -> Complex:
    """Return the mean of profiles along the path of a mean current, shape (1,) [m/s]; NaN if they cover too little of it.

    Args:
        memory: See ``_dives``.
        near: Absolute pings during the path.
        mean: Mean current.
    """
    depth, weight = (mean[name][0, : mean["points"][0]] for name in ("path_depth", "weight"))
    dive = np.bincount(near["dive"][near["dive"] > 0], minlength=1).argmax()
    cells = memory["sums"][dive % _DIVES] * (memory["dives"][dive % _DIVES] == dive > 0)
    cells = cells[cells[:, 0] > 0]
    if not len(cells):
        return np.full(1, np.nan + 0j)
    east, north, z = cells[:, 1:].T / cells[:, 0]
    apart = np.abs(z - depth[:, None]).min(axis=1)
    covered = np.where(apart <= _COVERED, weight, 0.0)
    current = np.interp(depth, z, east) + 1j * np.interp(depth, z, north)
    share = covered.sum()
    return np.array([current @ covered / share if share >= _LEAST_COVERED else np.nan])


def _compared(memory: Memory, near: Rows, mean: Rows, through_water: bool) -> dict[str, Array]:
    """Return the pairs of a mean current with the pings before it: ``current``, ``vehicle`` and ``blocks``.

    Args:
        memory: See ``_dives``.
        near: Latest pings of one instrument before it.
        mean: Mean current.
        through_water: Whether dead reckoning assumes no current.
    """
    path = mean["path_time"][0, : mean["points"][0]]
    during = near.take((near["time"] >= path[0]) & (near["time"] <= path[-1]))
    absolute, relative = during.take(~during["relative"]), during.take(during["relative"])
    velocity = mean["velocity"] @ (1.0, 1j)
    # without a current in the positions these are the way through water
    more = velocity[0] if through_water else 0.0
    profile = _along(memory, absolute, mean)
    dive, blocks = _blocks(absolute, more), _blocks(relative, more)
    platform, own = np.full((2, 1), np.nan)
    if len(dive):
        platform, own = dive["way"].mean(), dive["own"].sum() / dive["size"].sum()
    found = {
        "current": _pairs_of(profile, velocity, 1.0, path[:1]),
        "vehicle": _pairs_of(profile - own, velocity - platform, 1.0, path[:1]),
        "blocks": _pairs_of(blocks["near"], velocity - blocks["way"], 0.5, blocks["time"]),
    }
    return {name: pairs[~np.isnan(pairs).any(axis=1)] for name, pairs in found.items()}


def _blocks(near: Rows, more: complex) -> Rows:
    """Return the first pings of half-hour blocks with known velocity of the platform.

    Added columns: ``way``, this velocity, the mean ``near``, and the sum ``own`` of the platform's velocities of ``size`` pings.

    Args:
        near: Pings.
        more: Velocity added to that between positions [m/s].
    """
    starts = spaced(near["time"].tolist(), [], lambda one, other: other - one > _BLOCK * 1e9)
    size = np.diff(starts, append=len(near))
    way = _ways(near.take(np.column_stack([starts, starts + size - 1]).ravel()))[::2] + more
    own = np.where(np.isnan(near["moves"]), np.repeat(way, size), near["moves"])
    own, mean = (np.add.reduceat(each, starts) for each in (own, near["near"]))
    blocks = near.take(starts).having(way=way, near=mean / size, own=own, size=size)
    return blocks.take(~np.isnan(way))


def against_references(memory: Memory, pings: Rows, context: Context) -> Judged:
    """Check the profiles of one instrument against motion and mean currents.

    Args:
        memory: As in ``_dives``; the latest pings, up to 1024, by column; pairs ``current``, ``vehicle`` and ``blocks`` (up to 128, 6);
            columns with prefix ``chain`` of the ping (1,) that starts the next motion; ``before`` (1, 2), relative velocity and minus the
            platform's at the previous one, NaN without; ``motion`` and ``track`` with ``pair`` (up to 128, 6), ``time`` and ``number``.
        pings: Pings of one instrument.
        context: Mean currents.
    """
    new, start = _near_means(pings), 0
    near, held = history(memory, new, _COLUMNS, _APART, _PINGS)
    of_motion, found = _check_motion(memory, new, context.through_water)
    after = {**memory, **held, **of_motion}
    for at, event in enumerate(context.means.event.tolist()):
        mean = context.means.take(slice(at, at + 1))
        end = int(np.searchsorted(pings.event, event))
        after |= _dives(after, pings.take(slice(start, end)))
        until, start = near.until(event, _PINGS), end
        for kind, more in _compared(after, until, mean, context.through_water).items():
            after[kind] = np.concatenate([after.get(kind, more[:0]), more])[-_MOST:]
        if KNOWN.isdisjoint(context.known):
            found += cause_of(after, replace(mean, topic=pings.topic))
    return {**after, **_dives(after, pings.take(slice(start, None)))}, found


def means_against_motion(memory: Memory, means: Rows) -> Judged:
    """Check for mean currents that are equal to the last digit or inconsistent with dead reckoning.

    Positions reckoned with a current differ in other ways, which are not reported.

    Args:
        memory: ``velocity`` (3, 2) and ``times`` (3,) of the latest mean currents [m/s; ns, UTC]; the latest 128 pairs with dead reckoning,
            ``reckonedpair`` (6,), with times and numbers.
        means: Mean currents.
    """
    latest = latest_rows(memory, "velocity", means["velocity"], _EQUAL)
    times = latest_rows(memory, "times", means["time"], _EQUAL)
    found = means.first(
        (latest == latest[:, :1]).all(axis=(1, 2)),
        MEANS,
        lambda k: (
            f"{_EQUAL} dives in a row have the mean current {latest[k, 0, 0]:g} east, {latest[k, 0, 1]:g} north m/s"
        ),
        "a mean current that was never computed, logged as zero or the last one",
        "withhold them (--without dac), or compute them from dead reckoning",
        since=lambda k: times[k, 0],
    )
    velocity, reckoned = means["velocity"] @ (1.0, 1j), means["reckoned"] @ (1.0, 1j)
    new = means.having(pair=_pairs_of(velocity, reckoned, 1.0, means["path_time"][:, 0]))
    new = new.take(np.isfinite(reckoned) & (reckoned != velocity))
    pairs, held = history(memory, new, ("time", "pair"), 0.0, _MOST, "reckoned")
    for event in new.event.tolist():
        rows = pairs.until(event, _MOST)
        explained = explanation(rows["pair"], OF_DIVES._replace(least=CURRENT.least), TURNED)
        if explained and explained.slips[0]:
            found += finding_of(
                rows,
                explained,
                RECKONED,
                f"against fixes and dead-reckoned positions the mean currents look {explained.names}",
                "the axes or signs of the mean currents",
                'check which variable is east; withhold them (--without dac), or compute them (dead_reckoning = "through_water")',
            )
    return {**held, "velocity": latest[-1], "times": times[-1]}, found


def show_directions(memories: Mapping[tuple[str, str], Memory], instrument: str) -> bool:
    """Return whether pairs of an instrument would show wrong directions."""
    held = memories.get(("means", instrument), {})
    return any(
        name in held and tell_directions(held[name], kind) for name, kind in _SOURCES.items()
    )
