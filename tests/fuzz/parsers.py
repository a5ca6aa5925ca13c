"""What is fuzzed: each parser that is ours takes any bytes, and ends with values or an error of its own kind."""

import contextlib
import struct
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from replay_kit.config.run import ForecastConfig, load_config
from replay_kit.core.errors import ConfigError, ForecastError, LogError
from replay_kit.forecast import read_ensemble
from replay_kit.logs import open_log
from replay_kit.logs.decode.decoders import decode_json
from tests.reference.adcp_records import nortek_sum

CORPUS = Path(__file__).parent / "corpus"


@cache
def _file() -> Path:
    return Path(tempfile.mkdtemp(prefix="replay-kit-fuzz-")) / "log"


def log(data: bytes) -> None:
    """A log: refused, or each of its messages is counted once, raw or decoded, and losses lie in the file."""
    _file().write_bytes(data)
    try:
        with open_log(_file()) as opened:
            raw = sum(1 for _ in opened.raw_messages())
            decoded = sum(1 for _ in opened.messages())
    except LogError:
        return
    report = opened.report()
    refused = sum(count for count, _ in report.undecodable.values())
    assert decoded + refused == sum(report.read.values())
    assert raw in (decoded, decoded + refused)
    places = [(loss.offset, loss.offset + loss.bytes) for loss in report.losses[:20]]
    assert all(0 <= start <= end <= len(data) for start, end in places)


def json(data: bytes) -> None:
    """JSON with bare NaN and infinities."""
    try:
        value = decode_json(data)
    # the json library's own answer to deep nesting, which PAYLOAD_ERRORS holds
    except (ValueError, RecursionError):
        return
    assert isinstance(value, dict)


def pd0(data: bytes) -> None:
    """A Teledyne file, every checksum set right: no flip would come further than the checksum otherwise."""
    sealed, at = bytearray(data), 0
    while (at := sealed.find(b"\x7f\x7f", at)) >= 0 and at + 4 <= len(sealed):
        (size,) = struct.unpack_from("<H", sealed, at + 2)
        end = at + max(size, 2)
        if end + 2 <= len(sealed):
            struct.pack_into("<H", sealed, end, sum(sealed[at:end]) & 0xFFFF)
        at = end
    log(bytes(sealed))


def ad2cp(data: bytes) -> None:
    """A Nortek file, every checksum set right."""
    sealed, at = bytearray(data), 0
    while (at := sealed.find(b"\xa5\x0a", at)) >= 0 and at + 10 <= len(sealed):
        (size,) = struct.unpack_from("<H", sealed, at + 4)
        end = at + 10 + size
        if end <= len(sealed):
            struct.pack_into("<H", sealed, at + 6, nortek_sum(sealed[at + 10 : end]))
            struct.pack_into("<H", sealed, at + 8, nortek_sum(sealed[at : at + 8]))
        at = end
    log(bytes(sealed))


def netcdf(data: bytes) -> None:
    """A NetCDF file, as a glider's log and as an ensemble."""
    log(data)
    with contextlib.suppress(ForecastError):
        read_ensemble(_file(), ForecastConfig())


def toml(data: bytes) -> None:
    """A configuration."""
    _file().write_bytes(data)
    with contextlib.suppress(ConfigError):
        load_config(_file())


PARSERS: dict[str, Callable[[bytes], None]] = {
    **dict.fromkeys(("mcap", "tlog", "dataflash"), log),
    **{parser.__name__: parser for parser in (json, pd0, ad2cp, netcdf, toml)},
}
