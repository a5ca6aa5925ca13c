"""Download of forecasts: cost estimate, transfer, check and cache."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import zarr

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Address, Paths, addresses_in, as_groups
from replay_kit.core.region import inside
from replay_kit.forecast.files import with_dates
from replay_kit.forecast.members.collection import open_collection
from replay_kit.forecast.members.rules import parse_rule
from replay_kit.forecast.names import find_time
from replay_kit.forecast.remote.cut import Cut, plan_cuts, write_cut
from replay_kit.forecast.remote.kept import CACHE, Kept, key_of
from replay_kit.forecast.remote.parts import Wanted

_LOG = logging.getLogger(__name__)
# Without --max-download no more is received [bytes].
_MOST = 1e9
# From this on a download whose chunks make it ten times as large as its values must be asked for [bytes].
_WASTE, _LARGE = 10.0, 5e7


def cache_of(config: ForecastConfig) -> Kept:
    """Return the cache of fetched forecasts."""
    return Kept(CACHE if config.cache is None else Path(config.cache))


def with_files(given: Paths, files: dict[Address, Path]) -> tuple[tuple[Path, ...], ...]:
    """Return the arguments with files instead of addresses."""
    return tuple(
        tuple(files[path] if isinstance(path, Address) else path for path in group)
        for group in as_groups(given, "ensemble")
    )


def cuts_of(given: Paths, wanted: Wanted, config: ForecastConfig) -> tuple[Cut, ...]:
    """Return the parts to receive of an ensemble's addresses, in order.

    Raises:
        ForecastError: The forecast cannot be used, or covers another region or time.
    """
    with open_collection(given, parse_rule(config.members)) as found:
        cuts = {cut.served.address: cut for cut in plan_cuts(found, wanted, config)}
    return tuple(cuts[address] for address in addresses_in(given))


def cost(cuts: Sequence[Cut]) -> list[dict[str, Any]]:
    """Return the contents and cost of each cut."""
    rows: list[dict[str, Any]] = []
    for cut in cuts:
        name = (cut.current or cut.names)[0]
        dims = cut.served.ds.variables[name].dims
        rows.append(
            {
                "address": str(cut.served.address),
                "form": cut.served.form,
                "variables": list(cut.names),
                "shape": dict(zip(map(str, dims), cut.shape(name), strict=True)),
                "chunks": cut.served.chunks(name),
                "bytes": cut.values,
                "download_bytes": cut.received,
            }
        )
    return rows


def cost_text(row: dict[str, Any]) -> str:
    """Return the contents and cost of a cut as text."""
    shape = " x ".join(f"{size} {dim}" for dim, size in row["shape"].items())
    ratio, chunks = row["download_bytes"] / max(row["bytes"], 1), ""
    if row["chunks"] and ratio > 2.0:
        each = " x ".join(map(str, row["chunks"]))
        chunks = f"; its chunks ({each}) make that {ratio:.3g} times the values"
    return (
        f"{row['address']} ({row['form']}): {shape}, {row['bytes'] / 1e6:.4g} MB of values, {row['download_bytes'] / 1e6:.4g} MB to "
        f"receive{chunks}"
    )


def receive(
    cuts: Sequence[Cut],
    wanted: Wanted,
    config: ForecastConfig,
    kept: Kept,
    why: Mapping[str, object],
) -> tuple[Path, ...]:
    """Return the files of cuts after download into the cache.

    Args:
        cuts: Parts to receive.
        wanted: Requested part.
        config: Settings of the forecast.
        kept: Cache.
        why: Properties of the request for the records.

    Raises:
        ForecastError: The download exceeds the allowed size, or the server fails.
    """
    rows = cost(cuts)
    values, total = (sum(row[key] for row in rows) for key in ("bytes", "download_bytes"))
    for row in rows:
        _LOG.warning("fetching %s", cost_text(row))
    most = _MOST if config.max_download is None else 1e6 * config.max_download
    if total > most:
        raise ForecastError(
            f"{rows[0]['address']}: {total / 1e6:.4g} MB to download, more than --max-download {most / 1e6:.4g} MB; "
            "choose less with --region, --levels and --start, --end, or allow more"
        )
    if config.max_download is None and total > max(_WASTE * values, _LARGE):
        raise ForecastError(
            f"{rows[0]['address']}: {values / 1e6:.4g} MB of values cost {total / 1e6:.4g} MB, because of the chunks of the store; if that "
            f"is meant, ask for it: --max-download {int(total / 1e6 * 1.1) + 1}"
        )
    files, done, size = [], 0.0, float(values)
    for cut in cuts:
        record = {**_record(cut, wanted, config), **why, "print": cut.fingerprint()}

        def write(part: Path, cut: Cut = cut, record: Any = record) -> None:
            nonlocal done
            with zarr.config.set({"async.concurrency": _at_once(cut)}):
                done = write_cut(cut, part, record, done, size)

        files.append(kept.add(_readable(cut), write))
        _LOG.warning("received %s", files[-1])
    return tuple(files)


def covers(
    record: dict[str, Any],
    places: np.ndarray,
    deepest: float | None,
    span: tuple[int | None, int | None],
) -> bool:
    """Return whether the record of a fetched file covers positions, a depth [m] and a time span [ns, UTC]."""
    try:
        wanted, times = record["wanted"], record["times"]
        region = wanted["region"]
        if region is not None and len(places) and not inside(tuple(region), *places.T).all():
            return False
        if deepest is not None and wanted["deepest"] is not None and wanted["deepest"] < deepest:
            return False
        if times is None or span[0] is None or span[1] is None:
            return True
        day = 86_400 * 10**9
        return bool(times[0] - day <= span[0] and span[1] <= times[1] + day)
    except (LookupError, TypeError, ValueError):
        return False


def _at_once(cut: Cut) -> int:
    """Return the number of chunks received at once."""
    sizes = [
        np.prod(chunks) * cut.served.ds.variables[name].dtype.itemsize
        for name in cut.names
        if (chunks := cut.served.chunks(name))
    ]
    return int(np.clip(1.28e8 / max([1.0, *map(float, sizes)]), 1, 10))


def _readable(cut: Cut) -> str:
    """Return the file name of a cut: the host and the last part of the address."""
    text = str(cut.served.address).partition("://")[2] or str(cut.served.address)
    host, _, path = text.partition("/")
    return f"{host.partition(':')[0]}-{path.rstrip('/').rpartition('/')[2] or path}"


def _record(cut: Cut, wanted: Wanted, config: ForecastConfig) -> dict[str, object]:
    """Return the provenance of the values of a cut."""
    ds, times = cut.served.ds, None
    dims = ds.variables[cut.current[0]].dims if cut.current else ()
    time = find_time(ds, dims)
    if time is not None and time in ds.variables and time in cut.parts:
        part = with_dates(ds[[time]].isel({time: cut.parts[time][0]}))
        if part[time].dtype.kind == "M":
            dates = part[time].values.astype("M8[ns]").astype(np.int64)
            times = [int(dates.min()), int(dates.max())]
    settings = {"levels": config.levels, "lead": config.lead, "time": config.time}
    return {
        "address": str(cut.served.address),
        "key": key_of(cut.served.address),
        "form": cut.served.form,
        "fetched": datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "wanted": {**asdict(wanted), **settings},
        "times": times,
    }
