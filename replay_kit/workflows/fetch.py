"""Fetching of remote forecasts: cut to the needs of the logs, fetched once, and found again offline."""

import hashlib
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from replay_kit.config.run import EVERYWHERE, RunConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.atomic import atomic_file
from replay_kit.core.files.paths import Address, Paths, addresses_in
from replay_kit.core.plan import Place
from replay_kit.core.region import Region, around, degree_of_longitude, width
from replay_kit.core.region import text as region_text
from replay_kit.core.words.text import time_text
from replay_kit.forecast.describe import open_extent
from replay_kit.forecast.remote.apart import apart
from replay_kit.forecast.remote.fetch import (
    cache_of,
    covers,
    cuts_of,
    receive,
    with_files,
)
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
    """Part of one forecast that several missions need.

    Attributes:
        jobs: The missions; for one without logs the settings state the part.
        config: Their settings.
        reaches: Area and period of each.
    """

    jobs: tuple[ReplayJob, ...]
    config: RunConfig
    reaches: tuple[Reach, ...]

    @property
    def ensemble(self) -> Paths:
        """Files and addresses of the forecast."""
        return self.jobs[0].ensemble

    @property
    def addresses(self) -> tuple[Address, ...]:
        """Addresses of the forecast."""
        return addresses_in(self.ensemble)

    @property
    def goals(self) -> list[Place]:
        """Goals of the missions."""
        return [job.goal for job in self.jobs if job.goal is not None]

    @property
    def key(self) -> str:
        """Hash of the inputs that determine the part fetched."""
        config = self.config
        decisive = [
            *(key_of(address) for address in self.addresses),
            *(part.model_dump_json() for part in (config.forecast, config.time)),
            *(config.estimator.name, config.estimator.preset),
            *(job.goal for job in self.jobs),
            *(
                (reach.places.tolist(), reach.deepest, reach.first_ns, reach.last_ns)
                for reach in self.reaches
            ),
        ]
        return hashlib.sha256(repr(decisive).encode()).hexdigest()[:32]

    @property
    def deepest(self) -> float | None:
        """Greatest depth needed [m]; None if unknown."""
        depths = [reach.deepest for reach in self.reaches if reach.deepest is not None]
        if len(depths) < len(self.reaches):
            return None
        planner = self.config.planner
        stated = None if planner.depth is None else planner.diving().depth
        planned = [depth for depth in (stated, planner.max_depth) if self.goals and depth]
        return max(depths + [goal.depth for goal in self.goals] + planned)

    @property
    def span(self) -> tuple[int | None, int | None]:
        """First and last time [ns, UTC]; None if unknown."""
        firsts = [reach.first_ns for reach in self.reaches if reach.first_ns is not None]
        lasts = [reach.last_ns for reach in self.reaches if reach.last_ns is not None]
        return min(firsts, default=None), max(lasts, default=None)


@dataclass(frozen=True, slots=True, eq=False)
class Fetched:
    """Forecast as local files.

    Attributes:
        ensemble: Files of the forecast.
        regions: Part that each mission needs; None where it is determined again.
        files: Local copies of addresses.
        asked: Whether values were downloaded for it.
    """

    ensemble: tuple[tuple[Path, ...], ...]
    regions: tuple[FoundRegion | None, ...]
    files: tuple[Path, ...]
    asked: bool


def with_local_forecasts(jobs: Sequence[tuple[ReplayJob, RunConfig]]) -> list[ReplayJob]:
    """Return jobs whose forecasts are files; addresses are fetched, shared boxes once.

    Args:
        jobs: Jobs with their settings.

    Raises:
        LogError: A log cannot be opened.
        ForecastError: A forecast cannot be fetched or used, or is not available offline.
    """
    done = [job for job, _ in jobs]
    groups: dict[str, list[int]] = {}
    for number, (job, config) in enumerate(jobs):
        if addresses_in(job.ensemble):
            shared = job.ensemble, config.forecast, config.time, config.estimator, config.logs
            groups.setdefault(repr(shared), []).append(number)
    for members in groups.values():
        requests = [request_of(*jobs[k]) for k in members]
        for together in _sharing(requests):
            found = fetch(_joined([requests[k] for k in together]))
            for k, region in zip(together, found.regions, strict=True):
                job = done[members[k]]
                done[members[k]] = replace(
                    job, ensemble=found.ensemble, region=job.region or region
                )
    return [
        replace(job, against=tuple(_rival(job, each, config) for each in job.against))
        for job, (_, config) in zip(done, jobs, strict=True)
    ]


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
    return Request((needed,), config, (Logs([job.logs], config).reach,))


def _joined(requests: Sequence[Request]) -> Request:
    """Return the joint request of missions with the same settings."""
    jobs = tuple(job for request in requests for job in request.jobs)
    reaches = tuple(reach for request in requests for reach in request.reaches)
    return Request(jobs, requests[0].config, reaches)


def _sharing(requests: Sequence[Request]) -> list[list[int]]:
    """Return the groups of requests whose common box is hardly larger than their own boxes."""
    groups: list[list[int]] = []
    for number, request in enumerate(requests):
        for group in groups:
            own = [requests[k] for k in group] + [request]
            if _area(own) <= 1.5 * sum(_area([one]) for one in own):
                group.append(number)
                break
        else:
            groups.append([number])
    return groups


def _area(requests: Sequence[Request]) -> float:
    """Return the area of the places of requests, extended by half a degree [square degrees]."""
    places = np.concatenate([reach.places for one in requests for reach in one.reaches])
    if not len(places):
        return 0.0
    box = around(places, 55_000.0)
    return width(box) * (box[3] - box[1])


def _corners(box: Region) -> list[tuple[float, float]]:
    west, south, east, north = box
    return [(west, south), (west + 0.5 * width(box), south), (east, north)]


def fetch(request: Request) -> Fetched:
    """Return a forecast as files: earlier downloads if still current or offline, else new ones.

    Raises:
        ForecastError: The forecast cannot be fetched or used, or is not available offline.
    """
    kept = cache_of(request.config.forecast)
    held = kept.find(request.addresses, request.key)
    if request.config.forecast.offline:
        if held is None:
            return _fetched(request, _covering(request, kept), (None,) * len(request.jobs))
    elif (received := _asked(_received, request, held)) is not None:
        return received
    assert held is not None
    found = [None if one is None else from_record(one) for one in held[0][1]["regions"]]
    return _fetched(request, [path for path, _ in held], found)


def _received(request: Request, held: Sequence[Copy] | None) -> Fetched | None:
    """Return a forecast downloaded now as files; None if the files held are still current."""
    config = request.config.forecast
    if held is not None and _is_current(request, held):
        return None
    wanted, regions = wanted_of(request)
    why = {"request": request.key, "regions": [one and one.to_record() for one in regions]}
    cuts = cuts_of(request.ensemble, wanted, config)
    files = receive(cuts, wanted, config, why)
    return replace(_fetched(request, files, regions), asked=True)


def price(request: Request) -> list[dict[str, Any]]:
    """Return the contents and download size of each address of a request; only a patch that determines the margin is downloaded.

    Raises:
        ForecastError: See ``fetch``.
    """
    return _asked(_price, request)


def _price(request: Request) -> list[dict[str, Any]]:
    wanted = wanted_of(request)[0]
    return [cut.cost() for cut in cuts_of(request.ensemble, wanted, request.config.forecast)]


def _asked(call: Callable[..., _Value], request: Request, *more: object) -> _Value:
    """Return the result of a query to the servers of a request."""
    return apart(call, request, *more, what=str(request.addresses[0]))


def copy_whole(source: Path, out: Path) -> None:
    """Copy a file completely or not at all."""
    with source.open("rb") as held, atomic_file(out) as file:
        shutil.copyfileobj(held, file)


def _is_current(request: Request, held: Sequence[Copy]) -> bool:
    """Return whether the data sets of files are unchanged on the server."""
    wanted = Wanted(**{each.name: held[0][1]["wanted"][each.name] for each in fields(Wanted)})
    prints = [
        cut.fingerprint() for cut in cuts_of(request.ensemble, wanted, request.config.forecast)
    ]
    return prints == [record["print"] for _, record in held]


def _fetched(
    request: Request, files: Sequence[Path], regions: Sequence[FoundRegion | None]
) -> Fetched:
    local = with_files(request.ensemble, dict(zip(request.addresses, files, strict=True)))
    return Fetched(local, tuple(regions), tuple(files), asked=False)


def wanted_of(request: Request) -> tuple[Wanted, tuple[FoundRegion | None, ...]]:
    """Return the query to the servers, and the part that each mission needs; None for all of it.

    Raises:
        ForecastError: The forecast is of another place.
    """
    config = request.config
    stated, span = config.forecast.region, request.span
    if stated is not None or config.forecast.place:
        region = None if stated in (None, EVERYWHERE) else stated
        return Wanted(region, request.deepest, *span), (None,) * len(request.jobs)
    # refuses a forecast of other times before values are received for the margin
    cuts_of(request.ensemble, Wanted(None, None, *span), config.forecast)
    found, boxes = list[FoundRegion | None](), list[Region | None]()
    for job, reach in zip(request.jobs, request.reaches, strict=True):
        one = None
        if len(reach.places):
            with open_extent(request.ensemble, config.forecast, reach.first_ns) as extent:
                if extent is not None:
                    inside_extent(extent, reach.places)
            one = find_region(reach, request.ensemble, config, reach.first_ns, job.goals)
        found.append(one)
        boxes.append(None if one is None else _reached(one, reach))
    whole = None
    if None not in boxes:
        corners = [corner for box in boxes if box is not None for corner in _corners(box)]
        whole = around(corners, 0.0)
    return Wanted(whole, request.deepest, *span), tuple(found)


def _reached(region: FoundRegion, reach: Reach) -> Region:
    """Return the box of a region; for windows that follow the vehicle, the box of all windows within reach."""
    if not region.follows:
        return region.region
    high = region.region[3] - region.region[1]
    across = width(region.region) * degree_of_longitude(region.region[1])
    return around(reach.places, max(high * 111_195.0, across))


def _covering(request: Request, kept: Kept) -> list[Path]:
    """Return files of earlier downloads that cover a request; the part that the logs need is determined from them.

    Raises:
        ForecastError: No such files exist.
    """
    places = np.concatenate([reach.places for reach in request.reaches])
    files, span = [], request.span
    for address in request.addresses:
        copies = kept.copies(address)
        chosen = next(
            (path for path, record in copies if covers(record, places, request.deepest, span)),
            None,
        )
        if chosen is None:
            where = f" in {region_text(around(places, 0.0))}" if len(places) else ""
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
