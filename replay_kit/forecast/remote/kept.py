"""Cache of fetched forecasts, each under the hash of its contents, with a record of its source, time, extent and request.

The folder holds ``NAME-HASH.nc``, each whole or absent. The record is an attribute of the file, repeated in every result that used it.
"""

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py

from replay_kit.core.errors import ConfigError
from replay_kit.core.files.atomic import sync
from replay_kit.core.files.paths import Address

if TYPE_CHECKING:
    import xarray as xr

#: Attribute of a file that was cut from a forecast on a server: where it came from, as JSON.
RECORD = "replay_kit_fetched"
#: Folder of fetched forecasts, where the settings state none.
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "replay-kit"
_DIGITS = 12

#: A file, and its record.
Copy = tuple[Path, dict[str, Any]]


class Kept:
    """Cache of fetched forecasts in a folder.

    Args:
        folder: Folder, created when the first file is added.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find(self, addresses: Sequence[Address], request: str) -> tuple[Copy, ...] | None:
        """Return the newest files of addresses that answered a request; None if one is missing or damaged."""
        found = []
        for address in addresses:
            held = [copy for copy in self.copies(address) if copy[1].get("request") == request]
            sound = [copy for copy in held if copy[0].stem.endswith(_hash(copy[0])[:_DIGITS])]
            if not sound:
                return None
            found.append(sound[0])
        return tuple(found)

    def copies(self, address: Address) -> list[Copy]:
        """Return the files of an address with their records, newest first."""
        each = ((path, record_of(path)) for path in self.folder.glob("*.nc"))
        found = [
            (path, record)
            for path, record in each
            if record is not None and record.get("key") == key_of(address)
        ]
        return sorted(found, key=lambda copy: (str(copy[1].get("fetched")), copy[0]), reverse=True)

    def add(self, name: str, ds: "xr.Dataset") -> Path:
        """Return the path of a dataset's file, named by the hash of its contents; a failure leaves no file.

        Args:
            name: Readable part of the file's name.
            ds: Dataset in memory.
        """
        readable = "".join(c if c.isalnum() or c in "._-" else "-" for c in name)[:60].strip(".-")
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, text = tempfile.mkstemp(".part", "fetch-", self.folder)
        except OSError as error:
            raise ConfigError(
                f"{self.folder}: forecasts that are fetched cannot be kept there: {error.strerror}; choose a folder with forecast.cache"
            ) from error
        os.close(handle)
        part = Path(text)
        try:
            ds.to_netcdf(part, engine="h5netcdf")
            target = self.folder / f"{readable or 'forecast'}-{_hash(part)[:_DIGITS]}.nc"
            os.replace(part, target)
            sync(self.folder)
        finally:
            part.unlink(missing_ok=True)
        return target


def record_of(path: Path) -> dict[str, Any] | None:
    """Return the record of a fetched file: source, time and extent; None for any other file."""
    try:
        found = json.loads(attributes_of(path).get(RECORD, "null"))
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def attributes_of(path: Path) -> dict[str, str]:
    """Return the global text attributes of a NetCDF file; empty for a file of another kind."""
    try:
        with path.open("rb") as stream:
            mark = stream.read(4)
        held: dict[str, object] = {}
        if mark[1:] == b"HDF":
            with h5py.File(path, "r") as file:
                held = {name: file.attrs[name] for name in file.attrs}
        elif mark[:3] == b"CDF":
            from scipy.io import netcdf_file

            with netcdf_file(path, mmap=False) as classic:
                held = dict(classic._attributes)
    except (OSError, ValueError, LookupError, RuntimeError, TypeError, OverflowError):
        return {}
    texts = {
        name: text.decode("utf-8", "replace") if isinstance(text, bytes) else text
        for name, text in held.items()
    }
    return {name: text for name, text in texts.items() if isinstance(text, str)}


def key_of(address: Address) -> str:
    """Return a hash that identifies an address without revealing it."""
    without_login = re.sub(r"(?<=//)[^/?#]*@", "", address.url)
    return hashlib.sha256(without_login.encode()).hexdigest()[:16]


def _hash(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
