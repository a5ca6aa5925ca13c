"""Digests of a result's messages, with which a repeated run is compared as it goes."""

from dataclasses import dataclass

DIGEST_NAME = "replay_kit.digest"


@dataclass(frozen=True, slots=True)
class Digest:
    """The digest of a result's messages up to some place.

    Attributes:
        time_ns: When in the log [ns, UTC].
        messages: Number of messages before.
        sha256: Of their topics, times and data, in order.
    """

    time_ns: int
    messages: int
    sha256: str
