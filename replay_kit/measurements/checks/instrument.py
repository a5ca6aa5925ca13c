"""Checks of an instrument that is dead, hangs, or has a bad beam, by its velocities before any rotation; and of messages that come twice.

Noise makes it impossible that a living instrument gives zeros, equal cells, or a ping again. They are judged before any rotation, after
which equal values differ.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.measurements.checks.fold import Context, Found, Memory, Rows, carried, first

DEAD = "dead or stale instrument"
STUCK = "stuck cells"
BEAM = "a beam of the instrument"
DUPLICATES = "messages logged twice"
#: Cells from which the shape of a profile tells; fewer, as of a current meter or of a coarse resolution, may repeat.
LEAST_CELLS = 5
# Zeros in two cells are enough. Pings with which one is compared, those judged together, and the share and the run of bad ones from which
# the instrument is named.
_LEAST_ZEROS, _COMPARED, _WINDOW, _BAD, _RUN = 2, 16, 32, 8, 5
_WORDS = ("", "equal to an earlier ping's", "equal in all cells", "all zero")
# Pings in a row from which a cell is stuck, and from which it is named; the probability that chance makes such a run; runs below this are
# of living cells.
_STUCK_RUN, _STUCK_NAMED, _CHANCE, _LIVING = 6, 16, 1e-9, 3
# Pings after which beams and duplicates are judged; how many times as large as of the others the variance of a bad beam is, or as small;
# m/s, of a mean error velocity that neither noise nor an error of a beam's angle makes.
_LEAST, _UNLIKE, _MOST_ERROR = 30, 25.0, 0.1
# Odd numbers by which the bits of a ping's values are multiplied, to tell pings apart by one number each.
_FACTORS = np.random.default_rng(0).integers(1, 2**62, 4096) | 1


class Living(NamedTuple):
    """What is wrong with each of some pings: 0 for a sound one, or the place of its words; and the finding, if the instrument is dead."""

    wrong: NDArray[np.intp]
    found: list[Found]


def dead(memory: Memory, pings: Rows) -> tuple[Memory, Living]:
    """Return which pings are all zero, equal in all cells, or equal to one of the last 16.

    Args:
        memory: ``digest`` (up to 16, 2), time [ns] and number of the latest pings that tell; ``wrong`` (up to 32,), of these.
        pings: Of one topic.
    """
    raw = pings["raw"]
    known = np.isfinite(raw[..., :2]).all(axis=2)
    number, start = known.sum(axis=1), raw[np.arange(len(raw)), np.argmax(known, axis=1), :2]
    equal = ((raw[..., :2] == start[:, None]).all(axis=2) | ~known).all(axis=1)
    zero = equal & (start == 0.0).all(axis=1) & (number >= _LEAST_ZEROS)
    told = (number >= LEAST_CELLS) | zero
    digest = np.column_stack([pings["time"], _digest(raw)])[told]
    both = carried(memory, "digest", digest, _COMPARED)
    before, at = len(both) - len(digest), np.arange(len(digest))
    stale = np.zeros(len(digest), np.bool_)
    for lag in range(1, min(_COMPARED, len(both) - 1) + 1):
        now = at[at + before >= lag]
        one, other = both[now + before], both[now + before - lag]
        stale[now] |= (one[:, 1] == other[:, 1]) & (one[:, 0] != other[:, 0])
    kind = np.where(zero[told], 3, np.where(equal[told], 2, stale.astype(np.intp)))
    wrong = np.zeros(len(raw), np.intp)
    wrong[told] = kind
    window = carried(memory, "wrong", kind, _WINDOW)
    count = np.concatenate([[0], np.cumsum(window > 0)])
    ends = at + 1 + len(window) - len(kind)
    bad = count[ends] - count[np.maximum(ends - _WINDOW, 0)] >= _BAD
    bad |= (ends >= _RUN) & (count[ends] - count[np.maximum(ends - _RUN, 0)] == _RUN)
    found = list[Found]()
    if (judged := first(bad)) is not None:
        row, latest = int(np.flatnonzero(told)[judged]), window[: ends[judged]][-_WINDOW:]
        most = _WORDS[int(np.argmax(np.bincount(latest[latest > 0])))]
        words = (
            f"the velocities of {(latest > 0).sum()} of the last {len(latest)} pings are {most}",
            "an instrument that is off or hangs, or a logger that repeats its last message",
            "those profiles are not used; check the instrument's power and its logger",
        )
        found.append(pings.found(row, DEAD, words))
    return {"digest": both[-_COMPARED:], "wrong": window[-_WINDOW:]}, Living(wrong, found)


def _digest(raw: Array) -> NDArray[np.int64]:
    """Return a number for each ping's velocities, shape (n, m, k): equal ones have equal numbers."""
    flat = np.where(np.isfinite(raw), raw, -99.0).reshape(len(raw), -1)
    # cells that are missing at the end are no part of it
    factors = np.resize(_FACTORS, flat.shape[1])
    return np.asarray(((flat + 99.0).view(np.int64) * factors).sum(axis=1))


def stuck_cells(memory: Memory, pings: Rows) -> tuple[Memory, list[Found], NDArray[np.bool_]]:
    """Return which cells repeat one value ping after ping while others live, shape (n, m), and the finding if some do for long.

    Velocities are written with few digits: what share of the living cells repeats by chance says how long a run means something.

    Args:
        memory: ``last`` (1, m, k), the ping before; ``run`` (1, m), how often each cell has repeated; ``counts`` (2,), repeats of living
            cells and their number.
        pings: Of one topic, neither dead nor stale, in order.
    """
    raw, n = pings["raw"], len(pings)
    if not n:
        return memory, [], np.zeros(raw.shape[:2], np.bool_)
    before = carried(memory, "last", raw, 1)
    fresh = len(before) == n
    equal = np.zeros(raw.shape[:2], np.bool_)
    equal[fresh:] = (before[1:] == before[:-1]).all(axis=2)
    at = np.arange(n)[:, None]
    reset = np.maximum.accumulate(np.where(equal, -1, at), axis=0)
    run = np.where(reset < 0, at + 1 + (0 if fresh else memory["run"]), at - reset)
    living = run < _LIVING
    trials = np.column_stack(
        [(equal & living).sum(axis=1), (living & np.isfinite(raw).all(axis=2)).sum(axis=1)]
    )
    counts = np.cumsum(trials, axis=0) + (0 if fresh else memory["counts"])
    chance = (counts[:, 0] + 1.0) / (counts[:, 1] + 100.0)
    stuck = (pings["bins"] >= LEAST_CELLS)[:, None] & (run >= _STUCK_RUN)
    stuck &= run * np.log(chance)[:, None] < np.log(_CHANCE)
    found = list[Found]()
    long = np.asarray(stuck & (run >= _STUCK_NAMED))
    if (named := first(np.any(long, axis=1))) is not None:
        cells = np.flatnonzero(stuck[named]) + 1
        words = (
            f"{len(cells)} of {raw.shape[1]} cells ({cells[0]} to {cells[-1]}) repeat one value, {run[named].max()} pings in a row",
            "a logger that fills cells beyond the range with their last or a fixed value",
            "those cells are not used; nothing needs to be set",
        )
        found.append(pings.found(named, STUCK, words, "warning"))
    return {"last": raw[-1:], "run": run[-1:], "counts": counts[-1]}, found, stuck


def duplicates(
    memory: Memory, rows: Rows, context: Context | None = None
) -> tuple[Memory, list[Found]]:
    """Return that pings or positions come twice, equal, at one time, from one log: a third of the last 30.

    Args:
        memory: ``last`` (1, c), the row before: time, log, place and velocities; ``repeats`` (up to 30,), of the latest.
        rows: Of one instrument, or positions.
        context: Is not asked.
    """
    if not len(rows):
        return memory, []
    columns = [
        rows[name].astype(np.float64) for name in ("input", "topic", "longitude", "latitude")
    ]
    values = np.column_stack(columns)
    if "velocity" in rows.columns:
        values = np.column_stack([values, rows["velocity"].reshape(len(rows), -1)])
    # a time needs all of its digits
    times, both = (
        carried(memory, "time", rows["time"], 1),
        carried(memory, "last", np.nan_to_num(values, nan=-99.0), 1),
    )
    if len(times) != len(both):
        times = times[-len(both) :]
    again = (times[1:] == times[:-1]) & (both[1:] == both[:-1]).all(axis=1)
    again = np.concatenate([np.zeros(len(rows) - len(again), np.bool_), again])
    repeats = carried(memory, "repeats", again, _LEAST)
    count, found = np.concatenate([[0], np.cumsum(repeats)]), list[Found]()
    ends = np.arange(len(again)) + 1 + len(repeats) - len(again)
    many = (ends >= _LEAST) & (3 * (count[ends] - count[np.maximum(ends - _LEAST, 0)]) >= _LEAST)
    if (at := first(many)) is not None:
        number = int(count[ends[at]] - count[ends[at] - _LEAST])
        words = (
            f"{number} of the last {_LEAST} {'messages' if rows.topic else 'positions'} equal the one before, at the same time",
            "a log with every message twice, as of two recorders that were merged",
            "each is counted once; nothing needs to be set",
        )
        found.append(rows.found(at, DUPLICATES, words, "warning"))
    return {"time": times[-1:], "last": both[-1:], "repeats": repeats[-_LEAST:]}, found


def beams(memory: Memory, pings: Rows, context: Context) -> tuple[Memory, list[Found]]:
    """Return that one beam scatters unlike the others, by the second differences along it, or that the beams contradict each other.

    Args:
        memory: ``variances`` (up to 30, k) of the beams [m^2/s^2] and ``errors`` (up to 30,), mean error velocities [m/s], of the latest
            pings that tell.
        pings: Of one instrument.
        context: Is not asked.
    """
    texture, along = np.diff(pings["raw"], 2, axis=1), pings["along_beams"].astype(np.bool_)
    sound = np.asarray(np.isfinite(texture).all(axis=2))
    along = along & (pings["bins"] >= LEAST_CELLS) & np.any(sound, axis=1)
    at = np.flatnonzero(along)
    if not at.size:
        return memory, []
    squares, known = texture[at] ** 2, np.isfinite(texture[at])
    new = np.cumsum(np.where(known, squares, 0.0), axis=1)[:, -1] / np.maximum(known.sum(axis=1), 1)
    variances = carried(memory, "variances", new, _LEAST)
    error = pings["error_velocity"][at]
    stated = np.isfinite(error)
    errors = carried(memory, "errors", error[stated], _LEAST)
    seen = np.cumsum(stated) + len(errors) - int(stated.sum())
    found = list[Found]()
    if len(variances) >= _LEAST:
        window = np.lib.stride_tricks.sliding_window_view(variances, _LEAST, axis=0)
        usual = np.median(window, axis=-1)
        others = np.column_stack(
            [np.median(np.delete(usual, k, axis=1), axis=1) for k in range(usual.shape[1])]
        )
        ratios = usual / others
        worst = np.argmax(np.abs(np.log(np.maximum(ratios, 1e-9))), axis=1)
        ratio = ratios[np.arange(len(ratios)), worst]
        # of the window that ends with each new ping
        last = np.arange(len(ratios)) + _LEAST - 1 - (len(variances) - len(new))
        mean_error = _means(errors, seen)[np.maximum(last, 0)]
        unlike = ~((ratio > 1.0 / _UNLIKE) & (ratio < _UNLIKE))
        judged = first((unlike | (mean_error >= _MOST_ERROR)) & (last >= 0))
        if judged is not None:
            row = int(at[last[judged]])
            evidence = (
                f"beam {worst[judged] + 1} scatters {np.sqrt(ratio[judged]):.2g} times as much as the others"
                if unlike[judged]
                else f"the beams contradict each other by {mean_error[judged]:.2f} m/s in all cells (error velocity)"
            )
            words = (
                evidence,
                "the order or the directions of the beams, or one that is dead, blocked or disturbed",
                "its profiles are not used; leave that beam out, so that velocities are solved from the other three",
            )
            found.append(pings.found(row, BEAM, words, distrusts=True))
    return {"variances": variances[-_LEAST:], "errors": errors[-_LEAST:]}, found


def _means(errors: Array, number: NDArray[np.int64]) -> Array:
    """Return the size of the median of the last 30 of the first so many errors, for each number; 0 of fewer than 30."""
    if len(errors) < _LEAST:
        return np.zeros(len(number))
    of_each = np.abs(np.median(np.lib.stride_tricks.sliding_window_view(errors, _LEAST), axis=1))
    return np.where(number >= _LEAST, of_each[np.maximum(number - _LEAST, 0)], 0.0)
