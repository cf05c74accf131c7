"""Shares of cases: where all or none of them happened, their scatter is 0, and yet the share is not known exactly."""

import numpy as np
import pytest

from beamtouch_models.design.accuracy.statistics import share_of


@pytest.mark.parametrize("happened", [False, True])
@pytest.mark.parametrize("draws", [160, 999])
def test_a_share_of_none_and_of_all_is_uncertain_by_one_case(draws: int, *, happened: bool) -> None:
    share = share_of(np.full(draws, happened))
    assert share.value == float(happened)
    assert share.standard_error == pytest.approx(1 / draws)


def test_any_other_share_scatters_as_its_cases_do() -> None:
    happened = np.random.default_rng(1).uniform(size=16_000) < 0.3
    share = share_of(happened)
    assert share.value == happened.mean()
    # Of a binomial; 16 parts give it within some 20 %.
    assert share.standard_error == pytest.approx((0.3 * 0.7 / 16_000) ** 0.5, rel=0.5)
