"""Settings that are times: ISO 8601, UTC."""

from typing import Annotated

from pydantic import AfterValidator

from replay_kit.core.errors import ConfigError
from replay_kit.core.time import parse_time


def _checked_time(text: str) -> str:
    try:
        parse_time(text)
    except ConfigError as error:
        # the kind of error that pydantic gathers and names the key of
        raise ValueError(str(error)) from error
    return text


#: A setting that is a time.
Moment = Annotated[str, AfterValidator(_checked_time)]
