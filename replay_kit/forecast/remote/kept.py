"""Forecasts that were fetched, kept under the hash of their contents, and what was asked for when they were.

The folder holds ``NAME-HASH.nc``, each whole or absent, and ``HASH.json`` for each request: which files answered it.
"""

import hashlib
import json
import os
import re
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from replay_kit.core.atomic import sync
from replay_kit.core.errors import ConfigError
from replay_kit.core.paths import Address
from replay_kit.forecast.remote.record import record_of

_BLOCK, _DIGITS = 1 << 20, 12


@dataclass(frozen=True, slots=True)
class Answer:
    """What a request was answered with.

    Attributes:
        files: Files of its addresses, in order.
        prints: Fingerprints of their data sets.
        wanted: What was asked of the servers, by which they can be asked again.
        regions: For each log, or set of logs, the record of the part of the forecast that it needs; None where that is all.
    """

    files: tuple[Path, ...]
    prints: tuple[str, ...]
    wanted: Mapping[str, Any]
    regions: tuple[Mapping[str, str] | None, ...]


class Kept:
    """A folder of fetched forecasts.

    Args:
        folder: The folder; made when something is kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def find(self, request: Mapping[str, Any]) -> Answer | None:
        """Return what a request was answered with before; None where it was not, or a file is gone or damaged."""
        try:
            held = json.loads(self._name(request).read_text(encoding="utf-8"))
            files = tuple(self.folder / name for name in held["files"])
            if not all(path.stem.endswith(_hash(path)[:_DIGITS]) for path in files):
                return None
            return Answer(files, tuple(held["prints"]), held["wanted"], tuple(held["regions"]))
        except (OSError, ValueError, LookupError, TypeError, AttributeError):
            return None

    def remember(self, request: Mapping[str, Any], answer: Answer) -> None:
        """Keep what a request was answered with."""
        held = {**asdict(answer), "files": [path.name for path in answer.files]}
        self._whole(self._name(request), lambda part: part.write_text(json.dumps(held), "utf-8"))

    def copies(self, address: Address) -> list[tuple[Path, dict[str, Any]]]:
        """Return the files of an address with their records, the newest first."""
        found = []
        for path in self.folder.glob("*.nc"):
            record = record_of(path)
            if record is not None and record.get("key") == key_of(address):
                found.append((path, record))
        return sorted(
            found, key=lambda pair: (str(pair[1].get("fetched")), pair[0].name), reverse=True
        )

    def add(self, name: str, write: Callable[[Path], None]) -> Path:
        """Return a file that a function has written, under the hash of its contents; a failure leaves nothing.

        Args:
            name: What it is of.
            write: Writes it.
        """
        readable = "".join(c if c.isalnum() or c in "._-" else "-" for c in name)[:60].strip(".-")

        def named(part: Path) -> Path:
            return self.folder / f"{readable or 'forecast'}-{_hash(part)[:_DIGITS]}.nc"

        return self._whole(named, write)

    def _name(self, request: Mapping[str, Any]) -> Path:
        text = json.dumps(request, sort_keys=True)
        return self.folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.json"

    def _whole(self, name: Path | Callable[[Path], Path], write: Callable[[Path], object]) -> Path:
        """Write a file beside its name, and rename it once it is whole."""
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
            write(part)
            target = name if isinstance(name, Path) else name(part)
            os.replace(part, target)
            sync(self.folder)
        finally:
            part.unlink(missing_ok=True)
        return target


def key_of(address: Address) -> str:
    """Return what tells an address from others without showing what it holds."""
    without_login = re.sub(r"(?<=//)[^/?#]*@", "", address.url)
    return hashlib.sha256(without_login.encode()).hexdigest()[:16]


def _hash(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    return digest.hexdigest()
