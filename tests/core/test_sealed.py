"""Store files: what is not whole, of this kind and of this version is refused by name, and a write that fails leaves what was there."""

import errno

import pytest

from replay_kit.core.errors import LogError, ReplayKitError
from replay_kit.core.sealed import Kind, read_head, read_store, sealed, write_store

KIND = Kind("shelf", 3, "delete the file")
PARTS = [b"first", b"", bytes(range(200))]


@pytest.fixture
def store(tmp_path):
    write_store(tmp_path / "it", KIND, {"run": "a"}, PARTS)
    return tmp_path / "it"


def test_what_is_written_is_read(store):
    head, parts = read_store(store, KIND)
    assert (head["run"], [*map(bytes, parts)]) == ("a", PARTS)
    assert read_head(store, KIND) == head


@pytest.mark.parametrize("kind", [Kind("shelf", 4, "x"), Kind("basket", 3, "x")])
def test_another_kind_or_version_is_refused(store, kind):
    assert read_head(store, kind) is None
    with pytest.raises(LogError, match=f"the {kind.name} cannot be used: it is of another kind or"):
        read_store(store, kind)


def test_cut_anywhere_or_with_any_bit_flipped_it_is_refused_by_name(store):
    data = store.read_bytes()
    for place, byte in enumerate(data):
        for damaged in (data[:place], data[:place] + bytes([byte ^ 4]) + data[place + 1 :]):
            store.unlink()
            store.write_bytes(damaged)
            with pytest.raises(LogError, match=f"^{store}: .*shelf"):
                read_store(store, KIND)


def test_a_sealed_file_whose_head_promises_more_is_refused(store):
    store.unlink()
    for head in (b"[]", b"{}", b'{"bytes": ["x"]}', b"no JSON"):
        store.write_bytes(sealed(KIND.line + head + b"\n"))
        with pytest.raises(LogError, match="the shelf cannot be used"):
            read_store(store, KIND)


def test_on_a_full_disk_the_former_store_stays(store, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("replay_kit.core.atomic.os.fsync", full)
    with pytest.raises(ReplayKitError, match="is the disk full"):
        write_store(store, KIND, {"run": "b"}, PARTS)
    monkeypatch.undo()
    assert read_store(store, KIND)[0]["run"] == "a"
    # what is left over of the other one is no obstacle
    write_store(store, KIND, {"run": "c"}, PARTS)
    assert read_store(store, KIND)[0]["run"] == "c"
    assert [path.name for path in store.parent.iterdir()] == ["it"]
