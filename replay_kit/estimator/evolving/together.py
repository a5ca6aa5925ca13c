"""Super-observations: profiles that follow one another closely, as one update.

Rows h of one instrument at 1 to 10 Hz are nearly the same over and over. With h = V A, V (M x s) orthonormal and s the rank, the
rows V'h carry all that the M rows say: V' e has unit noise again, and what is left out is noise alone. Nothing is averaged, so places,
depths and errors may differ from profile to profile; only what the state forgets within the window is not followed.
"""

from collections.abc import Iterable, Iterator

import scipy.linalg

from replay_kit.types import Array, Observation, PathMean

# Of the largest singular value, below which there is only rounding.
_RANK = 1e-13


def compressed(rows: Array, innovation: Array) -> tuple[Array, Array]:
    """Return rows that say the same, at most as many as there are directions: shapes (s, n) and (s, c).

    Args:
        rows: shape (M, n), with independent noise of unit variance.
        innovation: shape (M, c).
    """
    vectors, values, directions = scipy.linalg.svd(rows, full_matrices=False)
    kept = values > _RANK * values[0]
    return values[kept, None] * directions[kept], vectors[:, kept].T @ innovation


def grouped(observations: Iterable[Observation | PathMean], window: float) -> Iterator[list[Observation | PathMean]]:
    """Yield observations in groups that lie within a window [s]; a mean along a path stays alone."""
    group: list[Observation | PathMean] = []
    for observation in observations:
        alone = isinstance(observation, PathMean) or (group and isinstance(group[0], PathMean))
        if group and (alone or not 0 <= observation.time_ns - group[0].time_ns <= window * 1e9 or window == 0.0):
            yield group
            group = []
        group.append(observation)
    if group:
        yield group
