"""Compact form of a flow in a result file: large arrays in float32, all others unchanged.

Float32 are the modes and the unknowns' patterns, and of the covariance P, in which only some directions differ from the prior's,

    P = I - V (I - M) V',    V' V = I,    M diagonal,

the directions V of all variances M that differ from 1 by more than 1e-6. A pattern that is a product of a depth function and modes is
stored as its factors. The velocity at the estimate's time is exact.
"""

import io
import json

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError
from replay_kit.core.flow.estimate import FlowEstimate
from replay_kit.core.flow.file import FIELDS, flow_of, held, kind_of

# Largest difference of a variance from the prior's that counts for nothing, and of a product from a pattern, of the pattern.
_VARIANCE, _PRODUCT = 1e-6, 1e-9
_COVARIANCE, _FIXED = "unknowns_covariance", "fixed"


def pack(flow: FlowEstimate) -> bytes:
    """Return a flow as the bytes of an archive of arrays (``.npz``); equal flows give equal bytes."""
    arrays = {
        name: np.asarray(value)
        for name, names, *_ in FIELDS
        if (value := held(flow, names)) is not None and np.size(value)
    }
    arrays["horizontal_functions"] = np.array(kind_of(flow))
    arrays["about"] = np.array(json.dumps(dict(flow.about)))
    if flow.span_ns is not None:
        arrays["data_span"] = np.array("{} {}".format(*flow.span_ns))
    if _COVARIANCE in arrays:
        arrays["variances"], arrays["directions"] = _eigen_parts(arrays.pop(_COVARIANCE))
    if _FIXED in arrays:
        arrays |= _factors(arrays.pop(_FIXED))
    for name in {"modes", "moving", "directions", _FIXED, "fixed_modes"} & arrays.keys():
        arrays[name] = arrays[name].astype(np.float32)
    file = io.BytesIO()
    np.savez(file, **arrays)  # type: ignore[arg-type]  # names of arrays, not of options
    return file.getvalue()


def unpack(data: bytes, name: str) -> FlowEstimate:
    """Return the flow of the bytes of ``pack``.

    Args:
        data: Bytes of ``pack``.
        name: Name of the data in errors.

    Raises:
        ForecastError: The data are damaged or of another kind.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as file:
            arrays = {
                key: each.astype(np.float64) if each.dtype == np.float32 else each
                for key, each in file.items()
            }
        if "variances" in arrays:
            arrays[_COVARIANCE] = _from_eigen_parts(arrays["variances"], arrays["directions"])
        if "fixed_modes" in arrays:
            arrays[_FIXED] = arrays["fixed_depths"][..., None] * arrays["fixed_modes"][:, None]
        attributes = {
            "horizontal_functions": arrays["horizontal_functions"].item(),
            "replay_kit_about": arrays["about"].item(),
        }
        if "data_span" in arrays:
            attributes["data_span"] = arrays["data_span"].item()
        found = {
            names: arrays[key] if arrays[key].ndim else arrays[key].item()
            for key, names, *_ in FIELDS
            if key in arrays
        }
        return flow_of(attributes, found)
    # what damaged bytes lead to has no end
    except Exception as error:
        raise ForecastError(
            f"{name}: expected an estimate of a result, but it is not one, or is damaged: {error}; replay the log again"
        ) from error


def _eigen_parts(p: Array) -> tuple[Array, Array]:
    """Return M, shape (n,), and V, shape (k, n), of a covariance."""
    less = np.eye(len(p)) - p
    # loads slowly, and what reads an estimate needs none
    from scipy.linalg.lapack import dpstrf

    lower, pivots, rank, _ = dpstrf(less, tol=1e-13, lower=1)
    factor = np.zeros((len(p), rank))
    factor[pivots - 1] = np.tril(lower)[:, :rank]
    if np.abs(less - factor @ factor.T).max(initial=0.0) > _VARIANCE**2:
        # some variance is larger than the prior's
        values, vectors = np.linalg.eigh(less)
    else:
        values, turned = np.linalg.eigh(factor.T @ factor)
        vectors = factor @ turned / np.sqrt(np.maximum(values, 1e-300))
    kept = np.abs(values) > _VARIANCE
    return 1.0 - values[kept], vectors[:, kept]


def _from_eigen_parts(variances: Array, directions: Array) -> Array:
    """Return the covariance, shape (k, k), of M, shape (n,), and V, shape (k, n), which float32 left nearly orthogonal."""
    orthogonal, _ = np.linalg.qr(directions)
    p = np.eye(len(directions)) - orthogonal * (1.0 - variances) @ orthogonal.T
    return np.asarray((p + p.T) / 2.0)


def _factors(patterns: Array) -> dict[str, Array]:
    """Return patterns, shape (B, K, r), by their stored names: as factors if all are products."""
    rows, largest = np.arange(len(patterns)), np.abs(patterns).max(axis=2).argmax(axis=1)
    of_modes = patterns[rows, largest]
    norm = np.maximum(np.sum(of_modes**2, axis=1), 1e-300)
    depths = np.einsum("bkr,br->bk", patterns, of_modes) / norm[:, None]
    apart = np.abs(patterns - depths[..., None] * of_modes[:, None]).max()
    if apart > _PRODUCT * np.abs(patterns).max():
        return {_FIXED: patterns}
    return {"fixed_depths": depths, "fixed_modes": of_modes}
