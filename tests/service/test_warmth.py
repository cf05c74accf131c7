"""Which samples zeros explain that moved together, and how many of them make warmth."""

import numpy as np
import pytest

from beamtouch_models.runtime import Evidence
from beamtouch_models.runtime.metadata_parts import Thresholds
from beamtouch_service.surfaces.warmth import Warmth, shift_of

LIMIT = 64.0
THRESHOLDS = Thresholds(
    touch=[1.0] * 4, rest=[1.0, 1.0, LIMIT / 2, LIMIT], misfit=[1.0] * 4, false_contacts_per_day=1.0
)


def sample(*deflection_mm: float, channels: int = 4) -> Evidence:
    """Return a sample of a precision of 16 per mm, in which so many channels took part."""
    weights = np.eye(4) * 16.0
    return Evidence(np.array(deflection_mm), weights, {}, channels, 0.0, False, 0.0, weights, True)


def test_a_sample_is_explained_by_a_shift_of_all_zeros_if_what_is_left_is_rest() -> None:
    assert shift_of(THRESHOLDS, sample(0.5, 0.5, 0.5, 0.5)) == 0.5
    assert shift_of(THRESHOLDS, sample(0.75, 0.25, 0.75, 0.25)) == 0.5  # what is left has a misfit of 64
    assert shift_of(THRESHOLDS, sample(0.76, 0.25, 0.75, 0.25)) is None


@pytest.mark.parametrize(("channels", "shift_mm"), [(2, None), (3, 0.5)])
def test_two_channels_are_moved_alike_by_a_load_between_them(channels: int, shift_mm: float | None) -> None:
    assert shift_of(THRESHOLDS, sample(0.5, 0.5, 0.5, 0.5, channels=channels)) == shift_mm


def test_warmth_is_what_explains_nine_of_ten_of_the_last_forty_samples() -> None:
    warmth = Warmth(THRESHOLDS)
    for number in range(36):
        assert warmth.shift_mm is None
        warmth.add(sample(*[0.25 if number < 17 else 0.5] * 4))
    assert warmth.shift_mm == 0.5  # the median
    for _ in range(4):
        warmth.add(sample(9.0, 0.0, 0.0, 0.0))
    assert warmth.shift_mm == 0.5
    warmth.add(sample(9.0, 0.0, 0.0, 0.0))  # the first of the forty counts no longer
    assert warmth.shift_mm is None


def test_a_stretch_that_is_over_counts_no_longer() -> None:
    warmth = Warmth(THRESHOLDS)
    for _ in range(40):
        warmth.add(sample(*[0.5] * 4))
    warmth.clear()
    assert warmth.shift_mm is None
