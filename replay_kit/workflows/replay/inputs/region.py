"""Part of a forecast that a log needs, found before its currents are read."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.paths import Paths
from replay_kit.core.plan import Place
from replay_kit.core.region import (
    DEGREE,
    Region,
    box_around,
    box_text,
    centre_of,
    degree_of_longitude,
    inside_box,
    width_of,
)
from replay_kit.estimator.basis.slices import correlation_length
from replay_kit.estimator.windows.placing import moved_into
from replay_kit.forecast.describe import Extent, open_extent
from replay_kit.forecast.members.collection import Collection

#: Name of the metadata record of a result that holds it.
REGION_RECORD = "replay_kit.found_region"
#: Correlation lengths between the log's positions and the side of the region found from them.
MARGIN_LENGTHS = 4.0
# Points a level of a forecast that is taken whole, and the share of a larger one from which on it is.
_SMALL, _MOST = 1200, 2.0 / 3.0
# Side of a window in correlation lengths, and its points at least, where the settings state none.
_SIDE_LENGTHS, _LEAST_WINDOW = 14.0, 1600
# Cells on each side of the place where the correlation length is measured.
_PATCH = 12


@dataclass(frozen=True, slots=True)
class FoundRegion:
    """Part of a forecast read by a run, found from its log.

    Attributes:
        region: West, south, east, north [degrees]; the first of windows that follow vehicles.
        margin: Distance between the vehicle and the region's sides [m].
        follows: Whether windows of this size follow each vehicle.
        bounds: Box of the whole forecast [degrees].
        note: Description of the part, for the user.
    """

    region: Region
    margin: float
    follows: bool
    bounds: Region
    note: str

    def about(self, place: tuple[float, float]) -> Region:
        """Return a window of this size around a place [degrees]."""
        size = np.array([width_of(self.region), self.region[3] - self.region[1]])
        return moved_into(self.bounds, place, 0.5 * size)

    def to_record(self) -> dict[str, str]:
        """Return the record of the region in a result."""
        return {
            "region": ",".join(map(repr, self.region)),
            "margin": repr(self.margin),
            "follows": str(self.follows).lower(),
            "bounds": ",".join(map(repr, self.bounds)),
            "note": self.note,
        }


def from_record(record: Mapping[str, str]) -> FoundRegion:
    """Return the region of a record by ``to_record``.

    Raises:
        ValueError: The record is invalid; also LookupError and TypeError.
    """
    region, bounds = (_numbers(record[key]) for key in ("region", "bounds"))
    return FoundRegion(
        region, float(record["margin"]), record["follows"] == "true", bounds, str(record["note"])
    )


def _numbers(text: str) -> Region:
    west, south, east, north = (float(part) for part in text.split(","))
    return west, south, east, north


def find_region(
    places_of: Callable[[], Array],
    ensemble: Paths | Collection,
    config: RunConfig,
    near_ns: int | None,
    goals: Sequence[Place],
) -> FoundRegion | None:
    """Return the part of a forecast that logs need; None for all of it, or if the settings state the part.

    The log is read only where the grid is large. The margin around positions and goals is a number of correlation lengths of the members'
    anomalies, measured in a patch of the first level amid the positions.

    Args:
        places_of: Returns the places of the logs, as in ``Reach``.
        ensemble: Ensemble files, opened or not.
        config: The run's settings.
        near_ns: Time of the logs' first message [ns, UTC].
        goals: Goals of the vehicles.

    Raises:
        ForecastError: The ensemble cannot be used; no position of the log lies in it; or the largest window is smaller than the margins
            around the vehicle.
    """
    settings = config.forecast
    if settings.region is not None or settings.place:
        return None
    with open_extent(ensemble, settings, near_ns) as extent:
        if extent is None or np.prod(extent.shape) <= _SMALL:
            return None
        places = inside_extent(extent, places_of())
        if not len(places):
            return None
        length = _length_near(extent, places)
        margin = MARGIN_LENGTHS * length
        region = box_around([*places, *((goal.longitude, goal.latitude) for goal in goals)], margin)
        points, whole = int(np.prod(extent.shape_in(region))), int(np.prod(extent.shape))
        most = settings.window_points or window_points(extent, length, float(places[0, 1]))
        # only an estimate that is the project's own and static can be passed from window to window
        static = config.time.scale == "static" or not extent.has_several_times
        is_default, changes = estimator_asked(config)
        if points > most and not goals and static and is_default and not changes:
            return _first_window(extent, places[0], margin, length, most)
        if points > _MOST * whole:
            return None
        what = "the log's positions and" if not goals else "the log's positions, the goal and"
        return FoundRegion(region, margin, False, extent.box, _note(extent, region, what, margin))


def estimator_asked(config: RunConfig) -> tuple[bool, bool]:
    """Return whether settings ask for the project's own estimator as it is by default, and whether for one that changes in time."""
    settings, time = config.estimator, config.time
    changes = time.scale not in ("auto", "static") or bool(time.oscillators or time.biases)
    return (settings.name, settings.preset) == ("reduced_basis", "default"), changes


def inside_extent(extent: Extent, places: Array) -> Array:
    """Return the places, shape (n, 2), that lie in the box of a forecast's grid.

    Raises:
        ForecastError: No place lies in it.
    """
    found = places[inside_box(extent.box, *places.T)]
    if len(places) and not len(found):
        raise ForecastError(
            f"{extent.source}: covers {box_text(extent.box)}, and no position of the log lies there: they lie in "
            f"{box_text(box_around(places, 0.0))}; use an ensemble of that place, or --place-ensemble for a study"
        )
    return found


def _length_near(extent: Extent, places: Array) -> float:
    """Return the correlation length [m] near the middle of positions, shape (n, 2), or near one of them if that is on land."""
    reach = _PATCH * np.array(extent.step)
    tried = [np.array(centre_of(box_around(places, 0.0))), *places[:: max(1, len(places) // 4)]]

    def length(place: Array) -> float:
        return correlation_length(extent.patch(box_around([place - reach, place + reach], 0.0)))

    for place in tried[:-1]:
        with suppress(ForecastError):
            return length(place)
    return length(tried[-1])


def window_points(extent: Extent, length: float, latitude: float) -> int:
    """Return the points per level of a window; larger ones have too few modes for their size, smaller ones more handovers."""
    cells = np.array(extent.step) * (degree_of_longitude(latitude), DEGREE)
    return max(_LEAST_WINDOW, math.ceil(np.prod(_SIDE_LENGTHS * length / cells)))


def _first_window(
    extent: Extent, place: Array, margin: float, length: float, most: int
) -> FoundRegion:
    """Return the largest window around the first position.

    Raises:
        ForecastError: It does not extend 1.5 margins to all sides.
    """
    # where the forecast is narrower than a square, the window is longer
    (rows, columns), side = extent.shape, np.sqrt(most)
    counts = np.array([min(columns, max(side, most / rows)), min(rows, max(side, most / columns))])
    half = 0.5 * (counts - 1.0) * np.array(extent.step)
    region = moved_into(extent.box, place, half)
    free = counts < (columns, rows)
    reach = float(min((half * (degree_of_longitude(float(place[1])), DEGREE))[free]))
    if reach < 1.5 * margin:
        raise ForecastError(
            f"{extent.source}: a window of {most} points reaches {reach / 1e3:.0f} km, and {1.5 * margin / 1e3:.0f} km are needed around "
            f"the vehicle (correlation length {length / 1e3:.1f} km); allow more with forecast.window_points, or state the region"
        )
    what = "windows of this size follow the vehicle (--netcdf and --save-estimate hold the last one), with"
    note = _note(extent, region, what, margin)
    return FoundRegion(region, margin, True, extent.box, note)


def _note(extent: Extent, region: Region, what: str, margin: float) -> str:
    taken, whole = (
        " x ".join(map(str, shape)) for shape in (extent.shape_in(region), extent.shape)
    )
    return (
        f"of the forecast {taken} of {whole} points a level are read, {box_text(region)}: {what} {margin / 1e3:.0f} km around, "
        f"{MARGIN_LENGTHS:g} correlation lengths; --region all reads everything"
    )
