"""The numbers that scripts give, checked."""

import math

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError


def numbers(values: ArrayLike, name: str, *, least: float = -math.inf, most: float = math.inf) -> Floats:
    """Return numbers as an array (values,); SceneError unless they are finite and from `least` to `most`."""
    try:
        found = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError):
        message = f"{name}: must be numbers"
        raise SceneError(message) from None
    if found.ndim != 1 or found.size == 0:
        message = f"{name}: must be one number, or a list of them that is not empty"
        raise SceneError(message)
    wrong = found[~(np.isfinite(found) & (found >= least) & (found <= most))]
    if wrong.size:
        bounds = (
            f" from {least:g} to {most:g}" if most < math.inf else f", at least {least:g}" if least > -math.inf else ""
        )
        message = f"{name}: must be finite{bounds} (given: {wrong[0]:g})"
        raise SceneError(message)
    return found


def places_in(values: ArrayLike, name: str, length_mm: float) -> Floats:
    """Return places on a beam of this length as an array (places,); SceneError if one is not on it."""
    return numbers(values, name, least=0.0, most=length_mm)


def at_least_one(value: int, name: str) -> None:
    """Raise SceneError unless a number of things is 1 or more."""
    if value < 1:
        message = f"{name} = {value}: give 1 or more"
        raise SceneError(message)
