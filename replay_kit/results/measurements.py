"""The measurements of a result as tables: all of them, or of a long log sums over all and as many as a figure shows.

A million measurements with their bins do not fit into memory beside what is made of them, so that views read them block by block.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.observation import Flag, Reason
from replay_kit.results.columns import ListValues, SingleValues, table_of

if TYPE_CHECKING:
    import pandas as pd

#: Measurements read at once, and the most measurements of profiles and bins that are kept for figures.
_BLOCK, MOST, MOST_BINS = 2048, 20_000, 300_000
_RMS = ("innovation", "residual", "prior_innovation")
#: What measurements are summed by, and how each of their values is.
_KEYS = ["dive", "source_topic", "mean_current_kind", "decision", "accepted"]
_SUMS = {
    **dict.fromkeys(("measurements", "with_bins", "dof", "nis", "signal_dof"), "sum"),
    **dict.fromkeys((f"square_{name}" for name in _RMS), "sum"),
    **{"first": "min", "last": "max"},
}
#: Measurements, a row each, and their bins; ``observation`` of a bin is the row of its measurement.
Tables = tuple["pd.DataFrame", "pd.DataFrame"]


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The measurements of a result as far as figures and tables need them.

    Attributes:
        observations: At most ``MOST`` measurements of profiles, evenly spread within each topic, and all mean currents, as
            ``Result.observations``.
        innovations: Their bins, as ``Result.innovations``.
        sums: Over all measurements, a row for each dive, topic, kind of mean current (empty for profiles), decision and whether accepted:
            ``measurements``, those ``with_bins`` that were used, ``dof``, ``nis``, ``signal_dof``, those for which the prior was
            ``square_*`` of the innovations [m^2/s^2], and times of the ``first`` and the ``last``.
        reasons: Number of bins not used by their reasons, sums of ``Reason``.
    """

    observations: "pd.DataFrame"
    innovations: "pd.DataFrame"
    sums: "pd.DataFrame"
    reasons: Counter[int]

    @property
    def count(self) -> int:
        """Number of measurements in the result."""
        return int(self.sums["measurements"].sum())

    @property
    def profiles(self) -> int:
        """Number of measurements with bins used that are no mean currents."""
        return int(self.sums["with_bins"][self.sums["mean_current_kind"] == ""].sum())

    @property
    def bins_rejected(self) -> dict[str, int]:
        """Number of bins not used by reason, in the order of the reasons; a bin can have several."""
        counts = {
            str(reason.name).lower(): sum(
                count for code, count in self.reasons.items() if code & int(reason)
            )
            for reason in Reason
            if reason
        }
        return {name: count for name, count in counts.items() if count}


def measurement_tables(
    messages: Iterable[Any], named: Callable[[dict[str, Any]], dict[str, Any]]
) -> Tables:
    """Return ``replay_kit.Innovation`` as tables.

    Args:
        messages: Decoded.
        named: Returns the columns of single values as this version of the contract names them.
    """
    values, lists = SingleValues("Innovation"), ListValues("Innovation", "depth")
    for message in messages:
        values.add(message)
        lists.add(message)
    single, (counts, columns) = named(values.columns()), lists.columns()
    dof = np.where(single["dof"] > 0, single["dof"], np.nan)
    rows, rms = np.repeat(np.arange(counts.size), counts), {}
    for name in _RMS:
        squares = np.nan_to_num(columns[f"{name}_east"] ** 2 + columns[f"{name}_north"] ** 2)
        rms[f"rms_{name}"] = np.sqrt(np.bincount(rows, squares, minlength=counts.size) / dof)
    of_bins = {
        "timestamp": np.repeat(single["timestamp"], counts),
        "observation": rows,
        "dive": np.repeat(single["dive"], counts),
    }
    return table_of(single | rms), table_of(of_bins | columns)


def measurement_blocks(
    messages: Iterable[Any], named: Callable[[dict[str, Any]], dict[str, Any]]
) -> Iterator[Tables]:
    """Yield ``measurement_tables`` of some messages after others; one block without rows where there are no messages."""
    left = iter(messages)
    block = measurement_tables(islice(left, _BLOCK), named)
    yield block
    while len((block := measurement_tables(islice(left, _BLOCK), named))[0]):
        yield block


def measured_of(blocks: Iterable[Tables], most: int = MOST, most_bins: int = MOST_BINS) -> Measured:
    """Return measurements as far as figures need them.

    Args:
        blocks: Of ``measurement_blocks``.
        most: Number of measurements of profiles from which on only every second is kept, then every fourth, and so on.
        most_bins: The same of their bins.
    """
    import pandas as pd

    kept, sums, reasons, seen, every = list[_Kept](), [], Counter[int](), Counter[str](), 1
    for observations, bins in blocks:
        sums.append(_sums(_addends(observations)))
        unused = ~np.isin(bins["flags"], [Flag.GOOD, Flag.SUSPECT])
        codes, counts = np.unique(bins["reasons"].to_numpy(np.int64)[unused], return_counts=True)
        reasons.update(dict(zip(codes.tolist(), counts.tolist(), strict=True)))
        kept.append(_Kept(_places(observations, seen), observations, bins).of_every(every))
        profiles = sum(int((one.place >= 0).sum()) for one in kept)
        if profiles > most or sum(len(one.bins) for one in kept) > most_bins:
            every *= 2
            kept = [one.of_every(every) for one in kept]
    firsts = np.cumsum([0, *(len(one.observations) for one in kept)])
    renumbered = [
        one.bins.assign(observation=one.bins["observation"] + first)
        for one, first in zip(kept, firsts, strict=False)
    ]
    tables = _joined([one.observations for one in kept]), _joined(renumbered)
    return Measured(*tables, _sums(pd.concat(sums, ignore_index=True)), reasons)


def dives_of(sums: "pd.DataFrame", fixes: "pd.DataFrame") -> "pd.DataFrame":
    """Return the dives of a result; see ``Result.dives``.

    Args:
        sums: Of ``Measured``.
        fixes: ``Result.fixes``.
    """
    import pandas as pd

    used = sums[sums["accepted"] & (sums["dive"] > 0)]
    begins, measured = used["first"].copy(), fixes.index[~fixes["dead_reckoned"].to_numpy(np.bool_)]
    before = measured.searchsorted(begins) - 1
    # a dive's mean current begins at the last position measured before its end
    known = (used["mean_current_kind"] == "dac").to_numpy() & (before >= 0)
    begins[known] = measured[before[known]]
    dives = used.assign(begin=begins).groupby("dive")
    dof = dives["dof"].sum()
    columns = {
        "start": dives["begin"].min(),
        "end": dives["last"].max(),
        "profiles": dives["measurements"].sum(),
        "bins": dof // 2,
    }
    rms = {f"rms_{name}": np.sqrt(dives[f"square_{name}"].sum() / dof) for name in _RMS}
    return pd.DataFrame({**columns, **rms, "nis_per_dof": dives["nis"].sum() / dof})


@dataclass(frozen=True, slots=True, eq=False)
class _Kept:
    """What is kept of a block; ``place`` counts the profiles of a topic from its first, and is -1 for mean currents."""

    place: NDArray[np.int64]
    observations: "pd.DataFrame"
    bins: "pd.DataFrame"

    def of_every(self, step: int) -> "_Kept":
        """Return of the profiles of each topic the first of each ``step``, and all mean currents."""
        wanted = (self.place < 0) | (self.place % step == 0)
        if wanted.all():
            return self
        rows = self.bins["observation"].to_numpy()
        bins = self.bins[wanted[rows]]
        number = (np.cumsum(wanted) - 1)[bins["observation"]]
        return _Kept(self.place[wanted], self.observations[wanted], bins.assign(observation=number))


def _places(observations: "pd.DataFrame", seen: Counter[str]) -> NDArray[np.int64]:
    """Return the places of ``_Kept``, and count on; instruments that take turns are thinned alike."""
    place = np.full(len(observations), -1)
    profile = observations["mean_current_kind"].isna().to_numpy()
    topics = observations["source_topic"].to_numpy()
    for topic in set(topics[profile].tolist()):
        here = np.flatnonzero(profile & (topics == topic))
        place[here] = seen[topic] + np.arange(here.size)
        seen[topic] += here.size
    return place


def _addends(observations: "pd.DataFrame") -> "pd.DataFrame":
    """Return measurements, a row each, with what is summed of them."""
    dof = observations["dof"]
    squares = {
        f"square_{name}": (observations[f"rms_{name}"] ** 2 * dof).fillna(0.0) for name in _RMS
    }
    return observations.assign(
        mean_current_kind=observations["mean_current_kind"].astype(object).fillna(""),
        measurements=1,
        with_bins=(dof > 0).astype(np.int64),
        first=observations.index,
        last=observations.index,
        **squares,
    )


def _sums(rows: "pd.DataFrame") -> "pd.DataFrame":
    return rows.groupby(_KEYS, as_index=False).agg(_SUMS)


def _joined(tables: Sequence["pd.DataFrame"]) -> "pd.DataFrame":
    """Return tables of the same columns one below the other, with the types of ``table_of``: pandas joins texts to another type."""
    held = [table for table in tables if len(table)] or tables[:1]
    if len(held) == 1:
        return held[0]
    columns = {"time": np.concatenate([table.index.to_numpy() for table in held])}
    for name in held[0]:
        columns[name] = np.concatenate([table[name].to_numpy() for table in held])
    return table_of(columns)
