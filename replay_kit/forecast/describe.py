"""Description of an ensemble's files: contents, interpretation and horizontal grid."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.files.paths import Paths
from replay_kit.core.grid import Ensemble
from replay_kit.core.region import DEGREE, Region, box_around
from replay_kit.forecast.field import Field
from replay_kit.forecast.files import find_sources, source_of
from replay_kit.forecast.gather import layout_of
from replay_kit.forecast.grids.axes import AxesCheck
from replay_kit.forecast.grids.horizontal import region_block
from replay_kit.forecast.grids.layout import Layout
from replay_kit.forecast.members.collection import Collection, open_collection
from replay_kit.forecast.members.rules import MemberRule, parse_rule
from replay_kit.forecast.members.selection import Selection, select
from replay_kit.forecast.names import NoCurrentError
from replay_kit.forecast.reader import read_members, read_selections, ways_text
from replay_kit.forecast.series import dates_of


@dataclass(frozen=True, slots=True, eq=False)
class Description:
    """Description of an ensemble's files.

    Attributes:
        source: Names of the files.
        grids: Files without a current: masks, coordinates, angles.
        rule: Definition of a member as the value of ``--members``; empty if undefined.
        ensemble: Members, or the single field; None without a current.
        names: Names of the velocity components.
        arrangement: Grid and staggering as text.
        check: Test of the axes; None without a current.
        use: Possible use of the files.
    """

    source: str
    grids: tuple[Path, ...]
    rule: str
    ensemble: Ensemble | None
    names: tuple[str, str]
    arrangement: str
    check: AxesCheck | None
    use: str


def describe_ensemble(
    path: Paths, config: ForecastConfig, near_ns: int | None = None
) -> Description:
    """Return the description of an ensemble's files: contents, interpretation and possible use.

    Args:
        path: Files, stores, folders or patterns.
        config: See ``read_ensemble``.
        near_ns: Time of the log [ns, UTC]; None without a log.

    Raises:
        ForecastError: The files cannot be read, or do not belong together. Files without a current raise no error.
    """
    files = find_sources(path).files
    try:
        with open_collection(path, parse_rule(config.members)) as found:
            return _described(found, config, near_ns)
    except NoCurrentError as error:
        use = f"no current: a file of the grid or of other variables ({error.variables}); give it with files of velocities"
        return Description(source_of(files), files, "", None, ("", ""), "", None, use)


def _described(found: Collection, config: ForecastConfig, near_ns: int | None) -> Description:
    if not found.rule.kind:
        one = select(replace(found, rule=MemberRule("dim")), config, near_ns)
        reading = read_selections([one], config, None, found.source, found.notes)
        use = f"one field, which --truth takes; no ensemble{ways_text(found)}"
    else:
        reading = read_members(found, config, near_ns, None)
        use = f"an ensemble of {reading.series[0].n_members} members"
    current = reading.field.current
    assert current is not None
    return Description(
        found.source,
        found.grids,
        _rule(found),
        reading.series[0],
        (str(current.u), str(current.v)),
        reading.layout.name,
        reading.check,
        use,
    )


def _rule(found: Collection) -> str:
    rule = found.rule
    if rule.kind == "dim":
        return f"dim:{found.members[0][0].member}"
    more = rule.name or (f"{rule.days:g}d" if rule.kind == "times" else "")
    return f"{rule.kind}:{more}" if more else rule.kind


# Fields read of a patch at most.
_FIELDS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """Horizontal grid of a forecast.

    Attributes:
        found: Opened files.
        selection: Fields that become members.
        config: Settings of the forecast.
        layout: Layout of the first field.
    """

    found: Collection
    selection: Selection
    config: ForecastConfig
    layout: Layout

    @property
    def source(self) -> str:
        """Names of the files."""
        return self.found.source

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows and columns."""
        return self.layout.rows.size, self.layout.columns.size

    @property
    def box(self) -> Region:
        """Bounding box of the grid, widened by a cell; all longitudes for a global grid."""
        edges = (np.s_[0], np.s_[-1], np.s_[:, 0], np.s_[:, -1])
        sides = [np.column_stack([axis[side] for axis in self.layout.points]) for side in edges]
        return box_around(np.concatenate(sides), max(self.step) * DEGREE)

    @property
    def step(self) -> tuple[float, float]:
        """Median spacing of grid points towards east and north [degrees]."""
        east, north = (
            max(
                float(np.median(np.abs((np.diff(axis, axis=k) + 180.0) % 360.0 - 180.0)))
                for k in (0, 1)
            )
            for axis in self.layout.points
        )
        return east, north

    @property
    def has_several_times(self) -> bool:
        """Whether ``read_series`` returns more than one time."""
        chosen = self.config.lead is not None or self.config.time is not None
        return not chosen and dates_of(self.found, self.config).size > 1

    def shape_in(self, region: Region) -> tuple[int, int]:
        """Return the number of rows and columns of the block around a region; zeros if no point lies inside."""
        rows, columns = region_block(*self.layout.places, region) or ((), ())
        return len(rows), len(columns)

    def patch(self, region: Region) -> Ensemble:
        """Return the first fields of the first level in a region, before any change into members.

        Raises:
            ForecastError: See ``read_ensemble``.
        """
        fields, left = list[Field](), _FIELDS
        for field in self.selection.fields:
            if field.extra or not left:
                continue
            at = dict(field.at or {})
            if field.member is not None:
                at[field.member] = slice(left)
            fields.append(replace(field, at=at, labels=field.labels[:left]))
            left -= len(fields[-1].labels)
        some = replace(self.selection, fields=tuple(fields), change=None)
        settings = self.config.model_copy(update={"region": region, "levels": (0.0,)})
        try:
            return read_selections([some], settings, None, self.source, ()).series[0]
        except ForecastError:
            # terrain-following levels of deep water alone have none near 0 m
            if self.config.levels is None:
                raise
            deeper = settings.model_copy(update={"levels": (min(self.config.levels),)})
            return read_selections([some], deeper, None, self.source, ()).series[0]


@contextmanager
def open_extent(
    path: Paths | Collection, config: ForecastConfig, near_ns: int | None
) -> Iterator[Extent | None]:
    """Give the horizontal grid of a forecast; None if its files do not define a member.

    Args:
        path: See ``read_ensemble``.
        config: See ``read_ensemble``; the region is ignored.
        near_ns: See ``read_ensemble``.

    Raises:
        ForecastError: See ``read_ensemble``.
    """
    with open_collection(path, parse_rule(config.members)) as found:
        if not found.rule.kind:
            yield None
            return
        selection = select(found, config, near_ns)
        yield Extent(found, selection, config, layout_of(selection.fields[0], config))
