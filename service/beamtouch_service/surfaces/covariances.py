"""Checks that the covariances that samples state are possible. Pure."""

import sys
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_service.samples import Sample

_ROUNDING = 1e-9
"""Largest negative eigenvalue of a covariance, as a part of its largest variance: senders round entries."""
_ENTRIES = 16_384
"""Entries of all matrices that are looked at together."""
_NEGATIVE = "has a negative value on its diagonal"
_NOT_ZERO = "must be 0 for a channel without a deflection"
_INDEFINITE = "is not positive semi-definite"


def find_flaws(samples: Sequence[Sample]) -> Iterator[dict[int, str]]:
    """Give, in steps, the index of each sample whose covariance is none, with what keeps it from being one.

    All samples have the same number of channels.
    """
    stated = [index for index, sample in enumerate(samples) if sample.covariance_mm2 is not None]
    if not stated:
        return
    together = _ENTRIES // len(samples[0].deflection_mm) ** 2
    for begin in range(0, len(stated), together):
        part = stated[begin : begin + together]
        reasons = _flaws([samples[index] for index in part])
        yield {index: reason for index, reason in zip(part, reasons, strict=True) if reason}


def _flaws(samples: Sequence[Sample]) -> list[str]:
    """Return what keeps the covariance of each sample from being one; empty if it is one.

    With the tolerated part of the largest variance added on its diagonal, it has a Cholesky factor if and only if no
    eigenvalue is below minus that part.
    """
    channels = len(samples[0].deflection_mm)
    lower = np.zeros((len(samples), channels, channels))
    lower[:, *np.tril_indices(channels)] = [sample.covariance_mm2 for sample in samples]
    is_missing = np.isnan(np.array([sample.deflection_mm for sample in samples], np.float64))  # null
    variances = np.diagonal(lower, axis1=1, axis2=2)
    is_negative = np.any(variances < 0, axis=1)
    is_not_zero = np.any(is_missing & np.any(lower, axis=2), axis=1)
    largest = variances.max(axis=1)
    largest[largest <= 0] = sys.float_info.min
    with np.errstate(over="ignore"):
        scaled = lower / largest[:, np.newaxis, np.newaxis]
    scaled[:, np.arange(channels), np.arange(channels)] += _ROUNDING
    each = zip(is_negative.tolist(), is_not_zero.tolist(), _are_indefinite(scaled), strict=True)
    return [
        _NEGATIVE if negative else _NOT_ZERO if not_zero else _INDEFINITE if is_indefinite else ""
        for negative, not_zero, is_indefinite in each
    ]


def _are_indefinite(lower: NDArray[np.float64]) -> list[bool]:
    """Return for each matrix, of which the lower triangle counts, whether it has no Cholesky factor."""
    if not np.isfinite(lower).all():  # entries too large for any covariance
        return [not np.isfinite(one).all() or _has_no_factor(one) for one in lower]
    return [_has_no_factor(one) for one in lower] if _has_no_factor(lower) else [False] * len(lower)


def _has_no_factor(lower: NDArray[np.float64]) -> bool:
    """Return whether a matrix has no Cholesky factor, or one of several has none."""
    try:
        np.linalg.cholesky(lower)
    except np.linalg.LinAlgError:
        return True
    return False
