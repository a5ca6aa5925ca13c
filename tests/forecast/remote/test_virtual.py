"""A store of 20 GB: no more bytes than the chunks of the box, no more memory than a few of them."""

import json
import math
from itertools import product

import numpy as np
import xarray as xr
import zarr

from tests.forecast.remote.servers import Files, serving

#: Members, times, levels, rows, columns; their chunks.
SHAPE, CHUNKS = (4, 10, 50, 1000, 2600), (1, 1, 10, 50, 50)
DIMS = ("member", "time", "depth", "lat", "lon")
_STEP, _SCALE = 0.05, 0.001


class VirtualStore:
    """Its objects by key; ``made`` holds the bytes of the chunks of currents that were asked for, by key."""

    def __init__(self) -> None:
        self.made: dict[str, int] = {}
        self._held = _described()
        self.size = 2 * 2 * math.prod(SHAPE)

    def __call__(self, key: str) -> bytes | None:
        key = key.partition("?")[0]
        name, _, position = key.partition("/")
        if name not in ("uo", "vo") or position.startswith("."):
            return self._held.get(key)
        chunk = _chunk(name, tuple(map(int, position.split("."))))
        self.made[key] = len(chunk)
        return chunk


def _chunk(name: str, position: tuple[int, ...]) -> bytes:
    """Packed values of a chunk: eddies that differ by member, move with time and fade with depth."""
    index = [
        at * chunk + np.arange(chunk, dtype=float)
        for at, chunk in zip(position, CHUNKS, strict=True)
    ]
    member, time, depth, y, x = np.meshgrid(*index, indexing="ij", sparse=True)
    phase = 0.25 * x + 0.2 * y + 1.7 * member + 0.3 * time
    other = 0.15 * x - 0.3 * y + 0.9 * member
    fade = np.exp(-depth / 25.0)
    if name == "uo":
        values = (-0.2 * np.cos(phase) * 0.2 + 0.3 * np.cos(other) * 0.2) * fade
    else:
        values = (0.25 * np.cos(phase) * 0.2 + 0.15 * np.cos(other) * 0.2) * fade
    return np.round(values / _SCALE * 5.0).astype("<i2").tobytes()


def _described() -> dict[str, bytes]:
    """Metadata and axes, without any current."""
    held: dict[str, object] = {}
    members, times, levels, rows, columns = SHAPE
    start = np.datetime64("2018-11-14T00", "ns")
    axes = xr.Dataset(
        coords={
            "member": ("member", np.arange(members), {"standard_name": "realization"}),
            "time": start + np.arange(times) * np.timedelta64(24, "h"),
            "depth": (
                "depth",
                5.0 + 15.0 * np.arange(levels),
                {"units": "m", "positive": "down", "standard_name": "depth"},
            ),
            "lat": ("lat", -60.0 + _STEP * np.arange(rows), {"units": "degrees_north"}),
            "lon": ("lon", 90.0 + _STEP * np.arange(columns), {"units": "degrees_east"}),
        }
    )
    store = zarr.storage.MemoryStore(held)
    axes.to_zarr(store, zarr_format=2, consolidated=False)
    group = zarr.open_group(store, mode="a", zarr_format=2)
    names = {"uo": "eastward_sea_water_velocity", "vo": "northward_sea_water_velocity"}
    for name, standard in names.items():
        made = group.create_array(
            name, shape=SHAPE, chunks=CHUNKS, dtype="<i2", compressors=None, fill_value=-32768
        )
        made.attrs.update(
            {
                "_ARRAY_DIMENSIONS": list(DIMS),
                "standard_name": standard,
                "units": "m s-1",
                "scale_factor": _SCALE,
            }
        )
    zarr.consolidate_metadata(store, zarr_format=2)
    objects = {key: value.to_bytes() for key, value in held.items()}
    assert "metadata" in json.loads(objects[".zmetadata"])
    return objects


#: 60 x 60 points.
BOX = (151.02, -41.03, 154.03, -38.02)


def touched(shape, first):
    """Chunks of both components that a box touches, in bytes."""
    ends = [
        range(low // c, (low + n - 1) // c + 1)
        for low, n, c in zip(first, shape, CHUNKS, strict=True)
    ]
    return 2 * len(list(product(*ends))) * 2 * math.prod(CHUNKS)


def test_no_chunk_is_received_that_the_box_does_not_touch(asker):
    store = VirtualStore()
    assert store.size > 20e9
    small = {"start": "2018-11-15T06:00Z", "end": "2018-11-15T18:00Z"}
    with serving(Files(store)) as files:
        found = asker(files.url, BOX, logs=small, levels=(5.0, 100.0))
    shape = tuple(found.sizes[dim] for dim in ("member", "time", "depth", "lat", "lon"))
    assert shape == (4, 2, 8, 60, 60)
    chunks = touched(shape, (0, 1, 0, 380, 1221))
    assert sum(store.made.values()) == chunks
    assert files.sent < 1.1 * chunks
