"""What a result's messages amount to: a repeated run can be compared with it on its way."""

from dataclasses import dataclass

DIGEST_NAME = "replay_kit.digest"


@dataclass(frozen=True, slots=True)
class Digest:
    """What a result's messages amount to up to some place.

    Attributes:
        time_ns: When in the log [ns, UTC].
        messages: Number of messages before.
        sha256: Of their topics, times and data, in order.
    """

    time_ns: int
    messages: int
    sha256: str
