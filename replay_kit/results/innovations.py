"""Innovations of a result as columns: blocks of observations to messages and back, and tables.

A block has a row per observation and the concatenated bins of all; each column is a list of the message with the layout of an array. Views
read block by block, as a long log may exceed memory.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.observation import Innovation
from replay_kit.results.mcap.schemas import ARRAYS, MESSAGES, decode, encode, numbers
from replay_kit.results.reader import ResultReader

if TYPE_CHECKING:
    import pandas as pd

TOPIC, _NAME = "/flow/innovation", "Innovations"
_FIELDS = {field.name: field.type for field in MESSAGES[_NAME]}
BINS = [*_FIELDS][[*_FIELDS].index("depth") :]
_MEANS = ("mean_current_measured", "mean_current_corrected")
_ENDS = ("_east", "_north")
#: Rows of tables made at once, and the most profiles and bins that are kept for figures.
_ROWS, MOST, MOST_BINS = 2048, 20_000, 300_000
_RMS = ("innovation", "residual", "prior_innovation")
#: What measurements are summed by, and how each of their values is.
_KEYS = ["dive", "source_topic", "mean_current_kind", "decision", "accepted"]
_SUMS = {
    **dict.fromkeys(("measurements", "with_bins", "dof", "nis", "signal_dof"), "sum"),
    **dict.fromkeys((f"square_{name}" for name in _RMS), "sum"),
    **{"first": "min", "last": "max"},
}
# A column that a block has for a while, the ordinal of each row.
_PLACE = "place"
#: Columns of a block by their names.
Columns = dict[str, NDArray[Any]]
#: Measurements, a row each, and their bins; ``observation`` of a bin is the row of its measurement.
Tables = tuple["pd.DataFrame", "pd.DataFrame"]


def block_of(innovations: Sequence[Innovation]) -> bytes:
    """Return ``replay_kit.Innovations`` without unknown columns."""
    known = dict[str, Any]()
    for field in MESSAGES[_NAME]:
        held: list[Any] = [*map(attrgetter(field.path), innovations)]
        if field.name.endswith(_ENDS):
            of_bins, end = field.name in BINS, field.name.endswith(_ENDS[1])
            rows = [one.depth.size if of_bins else 1 for one in innovations]
            held = [
                np.full(count, np.nan) if pair is None else np.atleast_2d(pair)[:, int(end)]
                for count, pair in zip(rows, held, strict=True)
            ]
        one_behind_the_other = field.name in BINS or field.name.endswith(_ENDS)
        values = np.concatenate(held) if one_behind_the_other else held
        if field.type not in ("float", "double") or not np.isnan(values).all():
            known[field.name] = values
    return encode(_NAME, known)


def columns_of(block: bytes) -> Columns:
    """Return the columns of ``replay_kit.Innovations``; unknown ones are NaN."""
    message, found = decode(_NAME, block), Columns()
    for name, kind in _FIELDS.items():
        found[name] = (
            numbers(_NAME, message, name)
            if kind in ARRAYS
            else np.array(getattr(message, name), dtype=object)
        )
    sizes = found["timestamp"].size, int(found["bins"].sum())
    for name, values in found.items():
        if not values.size and (size := sizes[name in BINS]):
            found[name] = np.full(size, np.nan, values.dtype)
    return found


def blocks_in(reader: ResultReader, newest: bool = False) -> Iterator[Columns]:
    """Yield the columns of the blocks of a result, also of earlier versions, forward or backward in time."""
    held = reader.schema(TOPIC)
    if held is not None and held.name == "replay_kit.Innovation":
        earlier = reader.decoded(TOPIC, newest)
        return (columns_of(encode(_NAME, _single_innovation(message))) for _, message in earlier)
    return (columns_of(data) for _, data in reader.messages(TOPIC, newest))


def _single_innovation(message: Any) -> dict[str, Any]:
    """Return the fields of a block with the single innovation of a message of contract version 5."""
    mean, held = message.mean_current, dict[str, Any]()
    for field in MESSAGES[_NAME]:
        value = getattr(message, field.name, 0 if field.name == "profiles" else ())
        if isinstance(value, str | int | float):
            held[field.name] = [value]
        elif isinstance(value, Sequence) and len(value) == len(message.depth):
            held[field.name] = value
    held["timestamp"] = [message.timestamp.ToNanoseconds()]
    held["source_time"] = [message.source_time.ToNanoseconds()]
    held["bins"], held["mean_current_kind"] = [len(message.depth)], [mean.kind]
    if message.HasField("mean_current"):
        for name in ("measured", "corrected", "estimated"):
            error = getattr(mean, f"{name}_standard_error", 0.0)
            held[f"mean_current_{name}_standard_error"] = [error or np.nan]
            if name == "measured" or (name == "corrected" and error > 0.0):
                for end in ("east", "north"):
                    held[f"mean_current_{name}_{end}"] = [getattr(mean, f"{name}_{end}")]
    return held


def joined_blocks(blocks: Iterable[Columns]) -> Columns:
    """Return joined blocks."""
    held = [_EMPTY, *blocks]
    return {name: np.concatenate([one[name] for one in held]) for name in _FIELDS}


_EMPTY = columns_of(b"")


def picked_rows(columns: Columns, wanted: NDArray[np.bool_]) -> Columns:
    """Return some rows of a block, with their bins."""
    of_bins = np.repeat(wanted, columns["bins"])
    return {name: each[of_bins if name in BINS else wanted] for name, each in columns.items()}


def larger_blocks(blocks: Iterable[Columns], rows: int = _ROWS) -> Iterator[Columns]:
    """Yield blocks joined to at least ``rows`` rows, except for the last one."""
    held, count = list[Columns](), 0
    for block in blocks:
        held.append(block)
        count += block["bins"].size
        if count >= rows:
            yield joined_blocks(held)
            held, count = [], 0
    yield joined_blocks(held)


def tables_of(columns: Columns) -> Tables:
    """Return the tables of a block: observations, with predicted and estimated mean currents; and bins."""
    single = {name: _plain(name, each) for name, each in columns.items() if name not in BINS}
    counts, kinds = single.pop("bins"), single["mean_current_kind"]
    rows, begins = np.repeat(np.arange(counts.size), counts), np.cumsum(counts) - counts
    means = np.flatnonzero((kinds != "") & (counts > 0))
    single["mean_current_kind"] = np.where(kinds == "", np.nan, kinds)
    for name, less in (("predicted", "innovation"), ("estimated", "residual")):
        for end in ("east", "north"):
            measured, corrected = (single[f"{mean}_{end}"] for mean in _MEANS)
            used = np.where(np.isnan(corrected), measured, corrected)
            values = np.full(counts.size, np.nan)
            values[means] = used[means] - columns[f"{less}_{end}"][begins[means]]
            single[f"mean_current_{name}_{end}"] = values
    dof = np.where(single["dof"] > 0, single["dof"], np.nan)
    for name in _RMS:
        pair = (columns[f"{name}_{end}"].astype(np.float64) for end in ("east", "north"))
        squares = sum(np.nan_to_num(component) ** 2 for component in pair)
        single[f"rms_{name}"] = np.sqrt(np.bincount(rows, squares, minlength=counts.size) / dof)
    of_bins = {name: single[name][rows] for name in ("timestamp", "dive")} | {"observation": rows}
    return table_of(single), table_of(of_bins | {name: columns[name] for name in BINS})


def _plain(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return a column of single values with the type of a table: times, and counts as signed integers."""
    if name in ("timestamp", "source_time"):
        return values.astype("datetime64[ns]")
    return values.astype(np.int64) if values.dtype.kind == "u" else values


def table_of(columns: Columns) -> "pd.DataFrame":
    """Return columns as a table without copying, with the first, times, as index ``time``."""
    import pandas as pd

    (_, times), *others = columns.items()
    return pd.DataFrame(dict(others), index=pd.DatetimeIndex(times, name="time"), copy=False)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """Measurements of a result, thinned for figures and tables.

    Attributes:
        observations: At most ``MOST`` profiles, evenly spread within each topic, and all mean currents, as ``Result.observations``.
        innovations: Their bins, as ``Result.innovations``.
        sums: Sums over all measurements by dive, topic, kind of mean current (empty for profiles), decision and acceptance:
            ``measurements``, those ``with_bins``, ``dof``, ``nis``, ``signal_dof``, those with a prior, ``square_*`` of the
            innovations [m^2/s^2], and times of ``first`` and ``last``.
    """

    observations: "pd.DataFrame"
    innovations: "pd.DataFrame"
    sums: "pd.DataFrame"

    @property
    def count(self) -> int:
        """Number of measurements in the result."""
        return int(self.sums["measurements"].sum())

    @property
    def profiles(self) -> int:
        """Number of measurements with used bins that are not mean currents."""
        return int(self.sums["with_bins"][self.sums["mean_current_kind"] == ""].sum())


def measured_of(
    blocks: Iterable[Columns], most: int = MOST, most_bins: int = MOST_BINS
) -> Measured:
    """Return measurements thinned for figures.

    Args:
        blocks: All blocks, which together may exceed memory.
        most: Number of profiles above which every second is kept, then every fourth, and so on.
        most_bins: The same limit for bins.
    """
    import pandas as pd

    sums, kept, seen, bins, every = list[pd.DataFrame](), list[Columns](), Counter[str](), 0, 1
    for columns in larger_blocks(blocks):
        observations, of_bins = tables_of(columns)
        sums.append(_sums(_addends(observations)))
        kept.append(columns | {_PLACE: _places(columns, seen)})
        bins += len(of_bins)
        while max(seen.total() / most, bins / most_bins) > every:
            every *= 2
        kept = [picked_rows(one, one[_PLACE] % every == 0) for one in kept]
    return Measured(*tables_of(joined_blocks(kept)), _sums(pd.concat(sums, ignore_index=True)))


def thinned(count: int, most: int) -> NDArray[np.intp]:
    """Return at most ``most`` of ``count`` indices, evenly spread, including the first and the last."""
    if count <= most:
        return np.arange(count)
    return np.unique(np.rint(np.linspace(0, count - 1, most)).astype(np.intp))


def rows_of_dives(sums: "pd.DataFrame") -> "pd.DataFrame":
    """Return the rows of ``Measured.sums`` on profiles and mean currents of dives; shear, radar and sensors are of no dive."""
    return sums[(sums["dive"] > 0) & sums["mean_current_kind"].isin(("", "dac", "drift"))]


def dives_of(sums: "pd.DataFrame", fixes: "pd.DataFrame") -> "pd.DataFrame":
    """Return the dives of a result; see ``Result.dives``.

    Args:
        sums: ``Measured.sums``.
        fixes: ``Result.fixes``.
    """
    import pandas as pd

    own = rows_of_dives(sums)
    begins, measured = own["first"].copy(), fixes.index[~fixes["dead_reckoned"].to_numpy(np.bool_)]
    before = measured.searchsorted(begins) - 1
    # a dive's mean current begins at the last position measured before its end
    known = (own["mean_current_kind"] == "dac").to_numpy() & (before >= 0)
    begins[known] = measured[before[known]]
    # what was rejected shows that there was a dive, and counts no further
    used = own.where(own["accepted"], 0)
    profiles = own["mean_current_kind"] == ""
    dives = used.assign(
        begin=begins,
        end=own["last"],
        profiles=used["measurements"] * profiles,
        bins=used["dof"] // 2 * profiles,
        mean_currents=used["measurements"] * ~profiles,
    ).groupby(own["dive"])
    dof = dives["dof"].sum()
    columns = {"start": dives["begin"].min(), "end": dives["end"].max()}
    columns |= {name: dives[name].sum() for name in ("profiles", "bins", "mean_currents")}
    rms = {f"rms_{name}": np.sqrt(dives[f"square_{name}"].sum() / dof) for name in _RMS}
    return pd.DataFrame({**columns, **rms, "nis_per_dof": dives["nis"].sum() / dof})


def _places(columns: Columns, seen: Counter[str]) -> NDArray[np.int64]:
    """Return the ordinal of each profile within its topic, and 0 for mean currents; ``seen`` is updated.

    Alternating instruments are thus thinned equally.
    """
    topics, place = columns["source_topic"], np.zeros(columns["bins"].size, np.int64)
    profiles = columns["mean_current_kind"] == ""
    for topic in dict.fromkeys(topics[profiles].tolist()):
        here = np.flatnonzero(profiles & (topics == topic))
        place[here] = seen[topic] + np.arange(here.size)
        seen[topic] += here.size
    return place


def _addends(observations: "pd.DataFrame") -> "pd.DataFrame":
    """Return measurements, one row each, with the terms of their sums."""
    dof, kind = observations["dof"], observations["mean_current_kind"].astype(object)
    squares = {
        f"square_{name}": (observations[f"rms_{name}"] ** 2 * dof).fillna(0.0) for name in _RMS
    }
    return observations.assign(
        mean_current_kind=kind.where(kind.notna(), ""),
        measurements=1,
        with_bins=(dof > 0).astype(np.int64),
        first=observations.index,
        last=observations.index,
        **squares,
    )


def _sums(rows: "pd.DataFrame") -> "pd.DataFrame":
    return rows.groupby(_KEYS, as_index=False).agg(_SUMS)
