"""Times of the configuration: ISO 8601, UTC."""

import re
from datetime import UTC, datetime, timedelta
from typing import Annotated

from pydantic import AfterValidator

from replay_kit.core.errors import ConfigError

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_LAST_NS = 2**63 - 1


def parse_time(text: str) -> int:
    """Return a time [ns, UTC] written in ISO 8601; without an offset it is UTC, with one it is converted.

    Raises:
        ConfigError: The text is no such time, or lies outside 1970..2262, the years that 64 bits of nanoseconds hold.
    """
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError as error:
        raise ConfigError(f"'{text}' is no time; write ISO 8601 UTC such as 2018-11-16T00:00:00Z") from error
    # a time with an offset is moved by hand, as datetime itself fails on those that leave its years 1..9999
    offset = moment.utcoffset() or timedelta(0)
    since = moment.replace(tzinfo=UTC) - _EPOCH - offset
    # datetime ends at microseconds; logs are stamped in nanoseconds
    digits = re.search(r"[.,]\d{6}(\d{1,3})", text)
    time_ns = since // timedelta(microseconds=1) * 1000 + (int(digits[1].ljust(3, "0")) if digits else 0)
    if not 0 <= time_ns <= _LAST_NS:
        raise ConfigError(f"'{text}' is outside 1970..2262; write a time of the mission such as 2018-11-16T00:00:00Z")
    return time_ns


def _checked_time(text: str) -> str:
    try:
        parse_time(text)
    except ConfigError as error:
        # the kind of error that pydantic gathers and names the key of
        raise ValueError(str(error)) from error
    return text


#: A setting that is a time.
Moment = Annotated[str, AfterValidator(_checked_time)]
