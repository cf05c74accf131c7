"""Which stated covariances can be none: each by its place among the samples, and with its reason."""

from collections.abc import Sequence

import pytest

from beamtouch_service.samples import Sample
from beamtouch_service.surfaces.covariances import find_flaws

NEGATIVE, INDEFINITE = "has a negative value on its diagonal", "is not positive semi-definite"
NOT_ZERO = "must be 0 for a channel without a deflection"
GOOD = [1.0, 0.0, 1.0]


def sample(triangle: Sequence[float] | None, missing: int | None = None, channels: int = 2) -> Sample:
    """Return a sample that states this lower triangle, of which one channel may be missing."""
    deflection_mm = [None if channel == missing else 0.5 for channel in range(channels)]
    quality = ["missing" if one is None else "good" for one in deflection_mm]
    members = {"sequence": 1, "acquired_unix_us": 1, "deflection_mm": deflection_mm, "quality": quality}
    return Sample.model_validate(members | {"readings": 4, "covariance_mm2": triangle})


def flaws(*triangles: Sequence[float] | None, missing: int | None = None) -> dict[int, str]:
    samples = [sample(triangle, missing) for triangle in triangles]
    return {index: reason for each in find_flaws(samples) for index, reason in each.items()}


def test_a_flaw_is_named_with_the_place_of_its_sample() -> None:
    found = flaws(None, GOOD, [1.0, 2.0, 1.0], None, [-1.0, 0.0, 1.0], GOOD)
    assert found == {2: INDEFINITE, 4: NEGATIVE}
    assert flaws() == flaws(None, None) == {}


@pytest.mark.parametrize("scale", [1e-6, 1.0, 4.0, 1e6])
def test_an_eigenvalue_may_be_below_zero_by_a_billionth_of_the_largest_variance(scale: float) -> None:
    """Of this matrix, the smaller one is minus that part."""
    for part, reason in ((0.9e-9, {}), (1.1e-9, {0: INDEFINITE})):
        assert flaws([scale, scale * (1 + part), scale]) == reason


def test_a_variance_may_be_zero_and_nothing_less() -> None:
    assert flaws([0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]) == {}
    assert flaws([0.0, 0.0, -1e-12], [1.0, 0.0, -1e-12]) == {0: NEGATIVE, 1: NEGATIVE}
    assert flaws([0.0, 1e-3, 0.0], GOOD, [0.0, 1e-3, 1.0]) == {0: INDEFINITE, 2: INDEFINITE}


def test_entries_that_no_variance_bears_spoil_only_their_own_sample() -> None:
    """Beside no variance at all they are beyond any number."""
    assert flaws([0.0, 1e8, 0.0], GOOD, [1.0, 2.0, 1.0], [1.0, 0.5, 1.0]) == {0: INDEFINITE, 2: INDEFINITE}


def test_a_channel_without_a_deflection_has_zeros_only() -> None:
    assert flaws([0.0, 0.0, 1.0], missing=0) == {}
    assert flaws([1.0, 0.0, 0.0], missing=1) == {}
    assert flaws([0.1, 0.0, 1.0], [0.0, 0.0, 1.0], missing=0) == {0: NOT_ZERO}
    assert flaws([1.0, 0.1, 0.0], [1.0, 0.0, 0.1], missing=1) == {0: NOT_ZERO, 1: NOT_ZERO}
    assert flaws([-1.0, 0.1, 0.0], missing=1) == {0: NEGATIVE}  # said first


@pytest.mark.parametrize(("channels", "together"), [(4, 1024), (64, 4)])
def test_so_many_are_looked_at_in_a_step_that_it_takes_a_millisecond(channels: int, together: int) -> None:
    triangle = [float(row == column) for row in range(channels) for column in range(row + 1)]
    one = sample(triangle, channels=channels)
    assert len(list(find_flaws([one] * together))) == 1
    assert len(list(find_flaws([one] * (together + 1)))) == 2
