"""Loads whose place was mistyped, on the paper's beam: which is named, and what the others say of it."""

from dataclasses import replace

import numpy as np
import pytest

from beamtouch_models.design.calibration.mistaken import mistaken
from beamtouch_models.design.calibration.recordings import Loads
from models.nominal_beam import loads_on, nominal_of

NOMINAL = nominal_of()


def recorded(count: int, load: int, off_mm: float) -> Loads:
    """Return loads on a perfect beam, of which one stands so far from where it is said to stand."""
    loads = loads_on(NOMINAL, np.zeros(16), 0, count)
    place_mm = loads.place_mm.copy()
    place_mm[load] += off_mm
    return replace(loads, place_mm=place_mm)


def test_a_mistyped_load_is_named_with_where_the_others_place_it() -> None:
    progress: list[float] = []
    (found,) = mistaken(NOMINAL, recorded(9, 5, 60.0), progress.append)
    assert (found.index, found.certain) == (5, True)
    true = recorded(9, 5, 0.0)
    assert found.place_mm == pytest.approx(true.place_mm[5], rel=0.03)
    assert found.force_n == pytest.approx(true.force_n[5], rel=0.03)
    assert progress == pytest.approx(np.arange(9) / 9)


def test_a_load_that_is_a_little_off_is_not_named() -> None:
    assert mistaken(NOMINAL, recorded(9, 5, 5.0)) == ()
