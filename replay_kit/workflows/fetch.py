"""Fetching of remote forecasts: cut to the needs of the logs, fetched once, and found again offline."""

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

from replay_kit.config.run import EVERYWHERE, RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.atomic import atomic_file
from replay_kit.core.files.paths import Address, addresses_in
from replay_kit.core.region import Region, box_around, degree_of_longitude, width_of
from replay_kit.core.region import box_text as region_text
from replay_kit.core.words.text import time_text
from replay_kit.forecast.describe import open_extent
from replay_kit.forecast.remote.apart import call_apart
from replay_kit.forecast.remote.fetch import Cut, cache_of, covers, cuts_of, receive, with_files
from replay_kit.forecast.remote.kept import Copy, Kept, key_of
from replay_kit.forecast.remote.parts import Wanted
from replay_kit.workflows.replay.inputs.job import Against, ReplayJob
from replay_kit.workflows.replay.inputs.region import (
    FoundRegion,
    find_region,
    from_record,
    inside_extent,
)
from replay_kit.workflows.replay.inputs.scan import Logs, Reach

_Value = TypeVar("_Value")


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """Part of a forecast that a mission needs.

    Attributes:
        job: The mission; without logs the settings state the part.
        config: Its settings.
        reach: Its area and period.
    """

    job: ReplayJob
    config: RunConfig
    reach: Reach

    @property
    def addresses(self) -> tuple[Address, ...]:
        """Addresses of the forecast."""
        return addresses_in(self.job.ensemble)

    @property
    def span(self) -> tuple[int | None, int | None]:
        """First and last time [ns, UTC]; None if unknown."""
        return self.reach.first_ns, self.reach.last_ns

    @property
    def key(self) -> str:
        """Hash of the inputs that determine the part fetched."""
        config, reach = self.config, self.reach
        decisive = [
            *(key_of(address) for address in self.addresses),
            *(part.model_dump_json() for part in (config.forecast, config.time)),
            *(config.estimator.name, config.estimator.preset, self.job.goal),
            (reach.places.tolist(), reach.deepest, reach.first_ns, reach.last_ns),
        ]
        return hashlib.sha256(repr(decisive).encode()).hexdigest()[:32]

    @property
    def deepest(self) -> float | None:
        """Greatest depth needed [m]; None if unknown."""
        if self.reach.deepest is None or (goal := self.job.goal) is None:
            return self.reach.deepest
        planner = self.config.planner
        stated = None if planner.depth is None else planner.diving().depth
        planned = [depth for depth in (stated, planner.max_depth) if depth]
        return max(self.reach.deepest, goal.depth, *planned)


@dataclass(frozen=True, slots=True, eq=False)
class Fetched:
    """Forecast as local files.

    Attributes:
        ensemble: Files of the forecast.
        region: Part that the mission needs; None if it is determined again.
        files: Local copies of addresses.
        asked: Whether values were downloaded for it.
    """

    ensemble: tuple[tuple[Path, ...], ...]
    region: FoundRegion | None
    files: tuple[Path, ...]
    asked: bool = False


def with_local_forecast(job: ReplayJob, config: RunConfig) -> ReplayJob:
    """Return a job whose forecasts are files; addresses are fetched.

    Raises:
        LogError: A log cannot be opened.
        ForecastError: A forecast cannot be fetched or used, or is not available offline.
    """
    against = tuple(_rival(job, each, config) for each in job.against)
    if not addresses_in(job.ensemble):
        return replace(job, against=against)
    found = fetch(request_of(job, config))
    region = job.region or found.region
    return replace(job, ensemble=found.ensemble, region=region, against=against)


def _rival(job: ReplayJob, each: Against, config: RunConfig) -> Against:
    """Return a competing forecast as files."""
    if not addresses_in((each,)):
        return each
    return fetch(request_of(replace(job, ensemble=(each,)), config)).ensemble[0]


def request_of(job: ReplayJob, config: RunConfig) -> Request:
    """Return the part of its forecast that a job needs; without logs the part that the settings state.

    Raises:
        LogError: A log cannot be opened.
    """
    needed = ReplayJob(job.logs, job.ensemble, goal=job.goal, vehicles=job.vehicles)
    return Request(needed, config, Logs([job.logs], config).reach)


def fetch(request: Request) -> Fetched:
    """Return a forecast as files: earlier downloads if still current or offline, else new ones.

    Raises:
        ForecastError: The forecast cannot be fetched or used, or is not available offline.
    """
    kept = cache_of(request.config.forecast)
    held = kept.find(request.addresses, request.key)
    if request.config.forecast.offline:
        if held is None:
            return _fetched(request, _covering(request, kept), None)
    elif (received := _asked(_received, request, held)) is not None:
        return received
    assert held is not None
    (record,) = held[0][1]["regions"]
    region = None if record is None else from_record(record)
    return _fetched(request, [path for path, _ in held], region)


def _received(request: Request, held: Sequence[Copy] | None) -> Fetched | None:
    """Return a forecast downloaded now as files; None if the files held are still current."""
    config = request.config.forecast
    if held is not None and _is_current(request, held):
        return None
    wanted, region = wanted_of(request)
    why = {"request": request.key, "regions": [region and region.to_record()]}
    files = receive(_cuts(request, wanted), wanted, config, why)
    return replace(_fetched(request, files, region), asked=True)


def _cuts(request: Request, wanted: Wanted) -> tuple[Cut, ...]:
    """Return the parts of each address that a query asks for."""
    return cuts_of(request.job.ensemble, wanted, request.config.forecast)


def price(request: Request) -> list[dict[str, Any]]:
    """Return the contents and download size of each address of a request; only a patch that determines the margin is downloaded.

    Raises:
        ForecastError: See ``fetch``.
    """
    return _asked(_price, request)


def _price(request: Request) -> list[dict[str, Any]]:
    return [cut.cost() for cut in _cuts(request, wanted_of(request)[0])]


def _asked(call: Callable[..., _Value], request: Request, *more: object) -> _Value:
    """Return the result of a query to the servers of a request."""
    return call_apart(call, request, *more, what=str(request.addresses[0]))


def copy_whole(source: Path, out: Path) -> None:
    """Copy a file completely or not at all."""
    with source.open("rb") as held, atomic_file(out) as file:
        shutil.copyfileobj(held, file)


def _is_current(request: Request, held: Sequence[Copy]) -> bool:
    """Return whether the data sets of files are unchanged on the server."""
    wanted = Wanted(**{each.name: held[0][1]["wanted"][each.name] for each in fields(Wanted)})
    prints = [cut.fingerprint() for cut in _cuts(request, wanted)]
    return prints == [record["print"] for _, record in held]


def _fetched(request: Request, files: Sequence[Path], region: FoundRegion | None) -> Fetched:
    copies = dict(zip(request.addresses, files, strict=True))
    return Fetched(with_files(request.job.ensemble, copies), region, tuple(files))


def wanted_of(request: Request) -> tuple[Wanted, FoundRegion | None]:
    """Return the query to the servers, and the part that the mission needs; None for all of it.

    Raises:
        ForecastError: The forecast is of another place.
    """
    job, config, reach = request.job, request.config, request.reach
    stated, span = config.forecast.region, request.span
    if stated is not None or config.forecast.place:
        region = None if stated in (None, EVERYWHERE) else stated
        return Wanted(region, request.deepest, *span), None
    # refuses a forecast of other times before values are received for the margin
    _cuts(request, Wanted(None, None, *span))
    if not len(reach.places):
        return Wanted(None, request.deepest, *span), None
    with open_extent(job.ensemble, config.forecast, reach.first_ns) as extent:
        if extent is not None:
            inside_extent(extent, reach.places)
    found = find_region(lambda: reach.places, job.ensemble, config, reach.first_ns, job.goals)
    box = None if found is None else _reached(found, reach)
    return Wanted(box, request.deepest, *span), found


def _reached(region: FoundRegion, reach: Reach) -> Region:
    """Return the box of a region; for windows that follow the vehicle, the box of all windows within reach."""
    if not region.follows:
        return region.region
    high = region.region[3] - region.region[1]
    across = width_of(region.region) * degree_of_longitude(region.region[1])
    return box_around(reach.places, max(high * 111_195.0, across))


def _covering(request: Request, kept: Kept) -> list[Path]:
    """Return files of earlier downloads that cover a request; the part that the logs need is determined from them.

    Raises:
        ForecastError: No such files exist.
    """
    places, files, span = request.reach.places, list[Path](), request.span
    for address in request.addresses:
        copies = kept.copies(address)
        chosen = next(
            (path for path, record in copies if covers(record, places, request.deepest, span)), None
        )
        if chosen is None:
            where = f" in {region_text(box_around(places, 0.0))}" if len(places) else ""
            when = f", {time_text(span[0])} to {time_text(span[1])}" if span[0] is not None else ""
            held = "; ".join(
                f"{path.name}, fetched {record.get('fetched')}" for path, record in copies[:3]
            )
            raise ForecastError(
                f"{address}: no earlier download covers the request{where}{when} "
                f"({held or f'none of this address in {kept.folder}'}); fetch it online: replay-kit fetch LOG... --ensemble "
                "ADDRESS, or with --region W,S,E,N --start TIME --end TIME"
            )
        files.append(chosen)
    return files
