"""Global heaps of NetCDF-4 files that the HDF5 library would read for ever."""

import h5py
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.netcdf.variables import endless_heap


@pytest.fixture
def sound(tmp_path):
    """A file whose texts are in one heap, and where that begins."""
    path = tmp_path / "texts.nc"
    with h5py.File(path, "w") as file:
        variable = file.create_dataset("time", data=[0.0, 1.0])
        # of 5 and of 16 bytes: one is padded, one not
        variable.attrs.create("units", "metre", dtype=h5py.string_dtype())
        variable.attrs.create("long_name", "sixteen letters.", dtype=h5py.string_dtype())
    data = path.read_bytes()
    assert data.count(b"GCOL") == 1
    return path, data.index(b"GCOL")


def _with(path, places):
    data = bytearray(path.read_bytes())
    for place, values in places.items():
        data[place : place + len(values)] = values
    path.write_bytes(data)
    return path


def _objects(data, heap):
    """Return where the two texts and the free space behind them begin."""
    first = heap + 16
    second = first + 16 + -(-int.from_bytes(data[first + 8 : first + 16], "little") // 8) * 8
    return [
        first,
        second,
        second + 16 + -(-int.from_bytes(data[second + 8 : second + 16], "little") // 8) * 8,
    ]


def test_a_sound_heap_ends(sound):
    assert endless_heap(sound[0]) is None


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_heap_with_free_space_of_no_size_is_found_and_its_file_refused(sound, which):
    path, heap = sound
    data = path.read_bytes()
    at = _objects(data, heap)[which]
    assert [data[place] for place in _objects(data, heap)] == [1, 2, 0]
    _with(path, {at: bytes(16)})
    assert endless_heap(path) == heap
    with pytest.raises(
        LogError,
        match=f"texts.nc: cannot be read as NetCDF: the texts from byte {heap} on are damaged",
    ):
        list(open_log(path).messages())
