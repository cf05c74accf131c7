"""A bar on two springs of 1 N/mm: structures whose deflections are levers."""

import numpy as np

from beamtouch_models.arrays import Floats

LENGTH_MM = 130.0


def scales(place_mm: Floats) -> Floats:
    """Return the influence at both ends [mm/N], (places, 2)."""
    share = place_mm / LENGTH_MM
    return np.concatenate([1 - share, share], axis=-1)


def three_scales(place_mm: Floats) -> Floats:
    """Return the influence at both ends, and at a sensor beside it that grows as x up to its middle, and then falls."""
    share = place_mm / LENGTH_MM
    return np.concatenate([1 - share, share, np.minimum(share, 1 - share)], axis=-1)
