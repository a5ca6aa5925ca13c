"""Global heaps of NetCDF-4 files that the HDF5 library would read for ever."""

import h5py
import pytest

from replay_kit.core.errors import LogError
from replay_kit.logs import open_log
from replay_kit.logs.netcdf.variables import endless_heap

TEXTS = "metre", "sixteen letters."


@pytest.fixture
def path(tmp_path):
    """A file whose texts are in one heap."""
    path = tmp_path / "texts.nc"
    with h5py.File(path, "w") as file:
        variable = file.create_dataset("time", data=[0.0, 1.0])
        # of 5 and of 16 bytes: one is padded, one not
        for name, text in zip(("units", "long_name"), TEXTS, strict=True):
            variable.attrs.create(name, text, dtype=h5py.string_dtype())
    return path


@pytest.mark.parametrize("which", [0, 1, 2])
def test_a_heap_with_free_space_of_no_size_is_found_and_its_file_refused(path, which):
    assert endless_heap(path) is None
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    # the heads of the two texts, and of the free space behind them
    first, second = (data.index(text.encode()) - 16 for text in TEXTS)
    at = [first, second, second + 32][which]
    assert data[at] == [1, 2, 0][which]
    data[at : at + 16] = bytes(16)
    path.write_bytes(data)
    assert endless_heap(path) == heap
    with pytest.raises(LogError, match=f"texts.nc: .* the texts from byte {heap} on are damaged"):
        list(open_log(path).messages())
