"""Current in the files of a forecast, which are opened when used."""

from collections.abc import Callable, Hashable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr
from numpy.typing import NDArray

from replay_kit.core.arrays import Times
from replay_kit.core.files.inputs import plain_attribute, why_no_input
from replay_kit.core.files.paths import Address
from replay_kit.forecast.files import opened_file, times_as_dates
from replay_kit.forecast.names import Current, find_lead, find_time

#: Attributes of a file that differ between products.
PRODUCT = ("title", "source", "institution", "product", "challenger")


@dataclass(frozen=True, eq=False)
class Field:
    """Current of a member or of members along a dimension, in one or two files.

    Attributes:
        paths: Paths of the files.
        like: Dataset of the same form.
        look: Reader of a coordinate.
        load: Reader of the dataset (``U`` and ``V`` if joined) and notes.
        argument: Position of its argument.
        current: Velocity components, if any.
        label: Label of the members.
        member: Dimension of the members; None for one.
        at: Positions of the time and members.
        labels: Origins of the members.
        extra: Whether it only builds members.
    """

    paths: tuple[Path, ...]
    like: xr.Dataset
    look: Callable[[str], xr.Variable]
    load: Callable[[], tuple[xr.Dataset, tuple[str, ...]]]
    argument: int = 0
    current: Current | None = None
    label: str = ""
    member: str | None = None
    at: Mapping[str, int | slice] | None = None
    labels: tuple[str, ...] = ()
    extra: bool = False

    @property
    def holds(self) -> tuple[bool, bool]:
        """Whether it has the first and the second component."""
        found = self.current
        return found is not None and found.u is not None, found is not None and found.v is not None

    @cached_property
    def ds(self) -> xr.Dataset:
        """Dataset at the chosen positions."""
        whole = self.load()[0]
        return whole if self.at is None else whole.isel(self.at)

    @property
    def at_last_time(self) -> "Field | None":
        """Field of the first member at the last lead or time; None if there is only one."""
        whole = self.load()[0]
        last = {dim: -1 for dim in self.at or () if dim != self.member and whole.sizes[dim] > 1}
        first = {} if self.member is None else {self.member: slice(1)}
        return replace(self, at={**last, **first}) if last else None

    @property
    def dims(self) -> tuple[Hashable, ...]:
        """Dimensions of the first component in the file."""
        assert self.current is not None, "asked of files with a current"
        return self.like.variables[self.current.u or self.current.v].dims

    @cached_property
    def time(self) -> str | None:
        """Dimension of times other than of the members; None without one."""
        return find_time(self.like, [dim for dim in self.dims if dim != self.member])

    @property
    def lead(self) -> str | None:
        """Dimension of leads; None without one."""
        return find_lead(self.like, self.dims)

    @property
    def count(self) -> int:
        """Number of members."""
        return 1 if self.member is None else self.like.sizes[self.member]

    @cached_property
    def stated_times(self) -> NDArray[Any]:
        """Times as stated, numbers if they have no date; empty without a dimension of times."""
        known = self.time is not None and self.time in self.like.coords
        return self.look(str(self.time)).values if known else np.zeros(0)

    @cached_property
    def times(self) -> Times:
        """Times [ns, UTC]; empty without dates."""
        times = self.stated_times
        dates = times if times.dtype.kind == "M" else np.zeros(0, "M8[ns]")
        return dates.astype("M8[ns]").astype(np.int64)

    @property
    def where(self) -> str:
        """Path of the first file, for messages."""
        return str(self.paths[0])

    @property
    def names(self) -> str:
        """Names of the files without their folders."""
        return " + ".join(path.name for path in self.paths)


def field_of(path: Path, ds: xr.Dataset, argument: int) -> Field:
    """Return the field of a dataset."""
    return Field((path,), ds, lambda name: ds[name].variable, lambda: (ds, ()), argument)


class Files:
    """Files that are opened on first use and closed together.

    A NetCDF-4 file of the same form as an open one (groups; names, sizes and types of all variables; the product) is opened only when its
    values are used. That holds for nearly all of a year of daily files.
    """

    def __init__(self, stack: ExitStack) -> None:
        self._stack, self._forms = stack, dict[Any, xr.Dataset]()

    def field(self, path: Path, argument: int) -> Field:
        """Return the field of a file, its components still unnamed.

        Raises:
            ForecastError: The file is missing or unreadable.
        """
        form, times = _seen(path, self._forms)
        if form is None or form not in self._forms:
            ds = self._opened(path)
            # those of packed times are not looked at without decoding
            packed = any("scale_factor" in axis.encoding for axis in ds.coords.values())
            if form is not None and not packed:
                self._forms[form] = ds
            return field_of(path, ds, argument)
        load = cache(partial(self._opened, path))

        def look(name: str) -> xr.Variable:
            return times[name] if name in times else load()[name].variable

        return Field((path,), self._forms[form], look, lambda: (load(), ()), argument)

    def _opened(self, path: Path) -> xr.Dataset:
        return self._stack.enter_context(opened_file(path))


def _seen(path: Path, forms: Mapping[Any, xr.Dataset]) -> tuple[Any, dict[str, xr.Variable]]:
    """Return the form of a NetCDF-4 file, None for other files; and its times if the form is known."""
    # of a pipe nothing may ever come
    if isinstance(path, Address) or why_no_input(path):
        return None, {}
    try:
        # of the library's own layer, as its objects take longer to make than to be asked
        file = h5py.h5f.open(bytes(path), h5py.h5f.ACC_RDONLY)
        about = [_text(file, name.encode()) for name in PRODUCT]
        items = {name: h5py.h5o.open(file, name) for name in file}
        sizes = [
            (name, item.shape, item.dtype.str, _text(item, b"standard_name"))
            for name, item in items.items()
            if isinstance(item, h5py.h5d.DatasetID)
        ]
        form = *items, *sizes, h5py.h5a.exists(file, b"bulletin_date"), *about
        time = find_time(forms[form], forms[form].dims) if form in forms else None
        return form, {} if time is None else {time: _times(items[time.encode()], time)}
    except (OSError, RuntimeError, TypeError, ValueError, LookupError):
        return None, {}


def _text(item: Any, name: bytes) -> str:
    """Return an attribute of an object of HDF5 as text; empty if it is absent."""
    if not h5py.h5a.exists(item, name):
        return ""
    attribute = h5py.h5a.open(item, name)
    value = np.empty((), attribute.dtype)
    attribute.read(value)
    return str(plain_attribute(value))


def _times(item: h5py.h5d.DatasetID, name: str) -> xr.Variable:
    """Return the times of a file, as dates if possible."""
    # an absent calendar is the usual one, an empty one is none
    about = {key: text for key in ("units", "calendar") if (text := _text(item, key.encode()))}
    variable = xr.Variable((name,), h5py.Dataset(item)[...], about)
    found = times_as_dates(variable)
    return variable if found is None else found
