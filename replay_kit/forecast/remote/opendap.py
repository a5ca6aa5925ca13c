"""OPeNDAP (DAP 2) as THREDDS, Hyrax, pydap and ERDDAP's griddap speak it: descriptions, attributes, and parts of arrays.

And Copernicus Marine, by its own client.

References:
    NASA ESE-RFC-004.1.1, The Data Access Protocol DAP 2.0: section 7 (DDS, DAS, data), section 4.1 (constraints).
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from replay_kit.core.errors import ForecastError
from replay_kit.core.paths import Address, public
from replay_kit.forecast.remote.answers import foreign_words, is_page
from replay_kit.forecast.remote.client import METADATA, Client

# Type, as it is sent (XDR), and as NetCDF has it.
_TYPES = {
    "byte": ("u1", "u1"),
    "int16": (">i4", "i2"),
    "uint16": (">u4", "u2"),
    "int32": (">i4", "i4"),
    "uint32": (">u4", "u4"),
    "float32": (">f4", "f4"),
    "float64": (">f8", "f8"),
}
_SLACK = 1 << 16
_ENDINGS = (".dds", ".das", ".dods", ".html", ".nc", ".nc4", ".graph")


@dataclass(frozen=True, slots=True)
class Declared:
    """A variable as a description declares it: its dimensions with their sizes, in order, and whether a grid brings its axes."""

    name: str
    kind: str
    dims: tuple[tuple[str, int], ...]

    @property
    def count(self) -> int:
        """Number of values."""
        return math.prod(size for _, size in self.dims)


def dataset_address(url: str) -> str:
    """Return the address of a data set, without the ending and the query of one of its answers."""
    parts = urlsplit(url)
    path = next(
        (parts.path.removesuffix(end) for end in _ENDINGS[:4] if parts.path.endswith(end)),
        parts.path,
    )
    return parts._replace(path=path, query="", fragment="").geturl()


def open_opendap(client: Client, url: str) -> xr.Dataset | None:
    """Return a data set whose values are received when they are used; None where the server speaks no OPeNDAP there.

    Raises:
        ForecastError: The description cannot be read.
    """
    described = client.probe(url + ".dds")
    if described is None or not re.match(rb"\s*dataset\s*{", described[:200], re.IGNORECASE):
        return None
    declared = {
        one.name: one
        for one in read_dds(_text(described), url)
        if one.kind in _TYPES and all(name for name, _ in one.dims)
    }
    attributes = read_das(_text(client.get(url + ".das", METADATA) or b""))
    variables = {}
    for name, one in declared.items():
        own = {key: _typed(key, value, one) for key, value in attributes.get(name, {}).items()}
        data = indexing.LazilyIndexedArray(_Values(client, url, one))
        variables[name] = xr.Variable([dim for dim, _ in one.dims], data, own)
    everywhere: dict[str, Any] = {}
    for name, found in attributes.items():
        if name not in declared and name.endswith("GLOBAL"):
            everywhere |= found
    ds = xr.Dataset(variables, attrs=everywhere)
    # axes are read once
    return ds.assign_coords({name: ds[name].load() for name in ds.dims if name in ds.variables})


class _Values(BackendArray):
    """An array on the server."""

    def __init__(self, client: Client, url: str, declared: Declared) -> None:
        self._client, self._url, self._declared = client, url, declared
        self.shape = tuple(size for _, size in declared.dims)
        self.dtype = np.dtype(_TYPES[declared.kind][1])

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.BASIC, self._read
        )

    def _read(self, key: tuple[int | slice, ...]) -> Any:
        ranges = [
            range(size)[part] if isinstance(part, slice) else range(part, part + 1)
            for part, size in zip(key, self.shape, strict=True)
        ]
        shape = tuple(map(len, ranges))
        squeezed = tuple(slice(None) if isinstance(part, slice) else 0 for part in key)
        if 0 in shape:
            return np.empty(shape, self.dtype)[squeezed]
        # square brackets are not allowed in an address
        part = "".join(
            f"%5B{taken[0]}:{abs(taken.step)}:{taken[-1]}%5D"
            if taken.step > 0
            else f"%5B{taken[-1]}:{-taken.step}:{taken[0]}%5D"
            for taken in ranges
        )
        one = self._declared
        expected = math.prod(shape) * np.dtype(_TYPES[one.kind][0]).itemsize + 8 * sum(shape)
        url = f"{self._url}.dods?{one.name}{part}"
        answer = self._client.get(url, expected + _SLACK)
        values = read_dods(answer or b"", one.name, self._url)
        if values.size != math.prod(shape):
            raise ForecastError(
                f"{public(self._url)}: expected {math.prod(shape)} values of {one.name}, got {values.size}; try again later"
            )
        turned = tuple(slice(None, None, -1 if taken.step < 0 else 1) for taken in ranges)
        return values.astype(self.dtype).reshape(shape)[turned][squeezed]


def read_dds(text: str, where: str) -> list[Declared]:
    """Return the variables of a description (DDS), those of a grid's maps after its array, in the order in which data are sent.

    Args:
        text: The description.
        where: The address, for messages.

    Raises:
        ForecastError: It is not of DAP 2.
    """
    words = iter(re.findall(r"[{};:\[\]=]|[^\s{};:\[\]=]+", text))
    try:
        if next(words).lower() != "dataset" or next(words) != "{":
            raise ValueError("no Dataset")
        return list(_declarations(words, ""))
    except (StopIteration, ValueError, RuntimeError, RecursionError) as error:
        raise ForecastError(
            f"{public(where)}: its description (.dds) is not of DAP 2: {error}; is it an OPeNDAP address?"
        ) from error


def _declarations(words: Iterator[str], within: str) -> Iterator[Declared]:
    while (word := next(words)) != "}":
        kind = word.lower()
        if kind in ("array", "maps") and within == "grid":
            if next(words) != ":":
                raise ValueError(f"no colon after {word}")
        elif kind in ("grid", "structure", "sequence"):
            if next(words) != "{":
                raise ValueError(f"no bracket after {word}")
            inner = list(_declarations(words, kind))
            while next(words) != ";":
                pass
            # what a sequence sends has no fixed size
            yield from inner if kind != "sequence" else ()
        else:
            name, dims, word = next(words), list[tuple[str, int]](), next(words)
            while word == "[":
                first, word = next(words), next(words)
                size = next(words) if word == "=" else first
                dims.append((_plain(first) if word == "=" else "", int(size)))
                if word == "=":
                    word = next(words)
                word = next(words)
            if word != ";":
                raise ValueError(f"no end of {name}")
            yield Declared(_plain(name), kind, tuple(dims))


def read_das(text: str) -> dict[str, dict[str, Any]]:
    """Return the attributes (DAS) of each variable, and of the data set under names that end in GLOBAL."""
    found: dict[str, dict[str, Any]] = {}
    path: list[str] = []
    entry = re.compile(
        r'\s*(?:(?P<end>})|(?P<open>[^\s{}"]+)\s*{|(?P<type>\w+)\s+(?P<name>[^\s"]+)\s+(?P<values>(?:"(?:[^"\\]|\\.)*"|[^;"])*);)'
    )
    at = 0
    while match := entry.match(text, at):
        at = match.end()
        if match["end"]:
            path = path[:-1]
        elif match["open"]:
            path.append(_plain(match["open"]))
        elif len(path) > 1:
            values = _values(match["type"].lower(), match["values"])
            if values:
                found.setdefault(path[1], {})[_plain(match["name"])] = (
                    values[0] if len(values) == 1 else values
                )
    return found


def _values(kind: str, text: str) -> list[Any]:
    if kind in _TYPES:
        known = np.dtype(_TYPES[kind][1])
        out = []
        for part in text.split(","):
            try:
                out.append(known.type(float(part) if known.kind == "f" else int(part)))
            except (ValueError, OverflowError):
                continue
        return out
    return [
        re.sub(r"\\(.)", r"\1", quoted) for quoted in re.findall(r'"((?:[^"\\]|\\.)*)"', text)
    ] or [text.strip()]


def _typed(name: str, value: Any, declared: Declared) -> Any:
    """Return an attribute; values that stand for missing ones have the type of the variable."""
    if name in ("_FillValue", "missing_value") and isinstance(value, np.generic):
        return value.astype(_TYPES[declared.kind][1])
    return value


def read_dods(answer: bytes, name: str, where: str) -> np.ndarray:
    """Return the values of a variable in an answer with data, in one dimension.

    Raises:
        ForecastError: The answer is an error, is cut, or does not hold the variable.
    """
    head, mark, data = answer.partition(b"\nData:")
    if not mark:
        said = re.search(rb'message\s*=\s*"((?:[^"\\]|\\.)*)"', answer)
        page = "a page of the web, as of a login" if is_page(answer) else "no data"
        what = _text(said[1]) if said else page
        raise ForecastError(f"{public(where)}: the server answers: {what[:200]}; ask for less")
    data = data[data.index(b"\n") + 1 :] if b"\n" in data[:3] else b""
    at = 0
    for one in read_dds(_text(head), where):
        if one.kind not in _TYPES:
            raise ForecastError(
                f"{public(where)}: {one.name} is of the type {one.kind}, expected numbers"
            )
        sent = np.dtype(_TYPES[one.kind][0])
        # the length of an array is sent twice; bytes are filled up to four
        at += 8 * bool(one.dims)
        size = one.count * sent.itemsize
        if len(data) < at + size:
            raise ForecastError(
                f"{public(where)}: the answer ends after {len(data)} bytes, within {one.name}; try again"
            )
        if one.name.rpartition(".")[2] == name.rpartition(".")[2]:
            return np.frombuffer(data, sent, one.count, at)
        at += size + (-size % 4)
    raise ForecastError(f"{public(where)}: the answer does not hold {name}")


def _plain(name: str) -> str:
    return re.sub(r"%([0-9A-Fa-f]{2})", lambda code: chr(int(code[1], 16)), name)


def _text(data: bytes) -> str:
    return data.decode("utf-8", "replace")


def open_cmems(address: Address, name: str) -> xr.Dataset:
    """Return a data set of Copernicus Marine, by the provider's own client, which keeps the login; times are numbers, as in a file.

    Raises:
        ForecastError: The client is not installed, or refuses.
    """
    try:
        import copernicusmarine
    except ImportError as error:
        raise ForecastError(
            f"{address}: needs the client of Copernicus Marine (EUPL licence): pip install 'replay-kit[cmems]'; then copernicusmarine login"
        ) from error
    try:
        ds: xr.Dataset = copernicusmarine.open_dataset(dataset_id=name)
    except Exception as error:
        raise ForecastError(
            f"{address}: Copernicus Marine's client answers: {foreign_words(error)}; is the name right, and copernicusmarine login done?"
        ) from error
    ds = ds.drop_encoding()
    dated = {
        name: xr.conventions.encode_cf_variable(variable, name=name)
        for name, variable in ds.variables.items()
        if variable.dtype.kind in "mM"
    }
    return ds.assign(dated)
