"""Characteristics of sensors from known loads: curves that are known give themselves back, for any scale and units."""

import numpy as np
import pytest

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.characteristic_fit import Characteristic, mean_at_places
from beamtouch_models.errors import SceneError

PLACES_MM, FORCES_N = np.array([20.0, 90.0, 150.0, 230.0]), np.array([2.0, 3.0, 5.0, 8.0, 12.0])
PLACE_MM, FORCE_N = np.repeat(PLACES_MM, 5), np.tile(FORCES_N, 4)
INFLUENCE = np.repeat([0.02, 0.05, 0.04, 0.03], 5)
STRAIGHT_MM = INFLUENCE * FORCE_N
NOISE_MM = 1e-4


def power_law(straight_mm: Floats) -> Floats:
    """Return what a sensor shows that grows with the power 0.8 of the deflection, and 0.6 mm at 0.6 mm."""
    shown: Floats = 0.6 * (straight_mm / 0.6) ** 0.8
    return shown


@pytest.mark.parametrize("scale", [1.0, 1000.0])
def test_a_power_law_comes_back_from_loads_whose_places_are_not_known(scale: float) -> None:
    shown = scale * power_law(STRAIGHT_MM)
    fit = Characteristic.fit("a", PLACE_MM[:, None], FORCE_N, shown, scale * NOISE_MM)
    assert len(fit.shown_mm) == 26
    assert fit.shown_mm[[0, 1, 2, -1]] == pytest.approx([-0.2 * 0.6 * scale, 0, shown.min(), 0.6 * scale])
    assert fit.straighten(shown) == pytest.approx(scale * STRAIGHT_MM, rel=0.01)
    assert fit.show(fit.straighten(shown)) == pytest.approx(shown, rel=1e-9)
    # Below the smallest load it is a straight line through rest, on either side of it.
    first = fit.straight_mm[2] / fit.shown_mm[2]
    assert fit.at_rest == pytest.approx(first)
    assert first == pytest.approx((shown.min() / (0.6 * scale)) ** 0.25, rel=0.02)
    assert fit.straighten(np.array([-0.1 * scale, 0.5 * shown.min()])) == pytest.approx(
        [-0.1 * scale * first, 0.5 * shown.min() * first]
    )
    assert np.isnan(fit.straighten(np.array([-0.121 * scale, 0.601 * scale]))).all()
    assert fit.show(np.array([9.0 * scale])) == pytest.approx([0.6 * scale])
    # The slope of shown^1.25, whose scale is that at the end.
    middle = np.array([0.2, 0.4]) * scale
    assert fit.slope(middle) == pytest.approx(1.25 * (middle / (0.6 * scale)) ** 0.25, rel=0.03)


def test_a_power_law_comes_back_from_loads_of_which_the_light_ones_count_less() -> None:
    """With this noise, the lightest load is known to 14 % and the heaviest to 5 %."""
    shown = power_law(STRAIGHT_MM)
    fit = Characteristic.fit("a", PLACE_MM[:, None], FORCE_N, shown, 0.01)
    assert fit.straighten(shown) == pytest.approx(STRAIGHT_MM, rel=0.01)


def test_a_power_law_comes_back_from_deflections_that_a_theory_knows() -> None:
    shown = power_law(STRAIGHT_MM)
    # Loads that the theory or the sensor does not see have no part.
    theory, seen = np.append(7 * STRAIGHT_MM, [0.0, -1.0, 1.0]), np.append(shown, [0.3, 0.3, 1.9 * NOISE_MM])
    fit = Characteristic.fit_to_known(theory, seen, NOISE_MM)
    assert fit.straighten(shown) == pytest.approx(STRAIGHT_MM, rel=0.01)


def test_what_loads_within_the_noise_show_counts_less_than_what_is_seen_well() -> None:
    """Seven loads show 0.02 mm too much, which is their noise: that changes what the others tell by a tenth."""
    light = STRAIGHT_MM < 0.11
    shown = power_law(STRAIGHT_MM) + 0.02 * light
    for fit in (
        Characteristic.fit("a", PLACE_MM[:, None], FORCE_N, shown, 0.02),
        Characteristic.fit_to_known(STRAIGHT_MM, shown, 0.02),
    ):
        assert fit.straighten(shown[~light]) == pytest.approx(STRAIGHT_MM[~light], rel=0.12)


def test_a_characteristic_rises_also_where_loads_say_that_it_falls() -> None:
    shown = np.array([0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    falling = shown * [1, 1, 1, 1, 1, 0.5, 0.3, 0.5, 1, 1, 1]
    fit = Characteristic.fit_to_known(falling, shown, NOISE_MM)
    assert np.diff(np.log(fit.straight_mm[2:])).min() == pytest.approx(1e-6, rel=1e-3)
    assert np.diff(fit.straight_mm[:3]).min() > 0


def test_a_straight_sensor_is_straight() -> None:
    fit = Characteristic.fit("a", PLACE_MM[:, None], FORCE_N, STRAIGHT_MM, NOISE_MM)
    between = np.linspace(0.05, 0.6, 30)
    assert fit.straighten(between) == pytest.approx(between, rel=1e-3)
    assert fit.slope(between) == pytest.approx(np.ones(30), rel=1e-2)


@pytest.mark.parametrize(
    ("chosen", "sign", "said"),
    [
        (PLACE_MM < 140, 1, "shows more than its noise with 2 forces at fewer than 3 places; measure with several"),
        (FORCE_N < 2.5, 1, "shows more than its noise with 2 forces at fewer than 3 places"),
        (
            PLACE_MM > 0,
            -1,
            "shows less than at rest under most loads, and a characteristic grows with the force; change",
        ),
    ],
)
def test_loads_that_do_not_tell_a_characteristic_are_refused(chosen: Floats, sign: int, said: str) -> None:
    shown = sign * STRAIGHT_MM[chosen]
    with pytest.raises(SceneError, match=f"^measured.curved: light {said}"):
        Characteristic.fit("light", PLACE_MM[chosen][:, None], FORCE_N[chosen], shown, NOISE_MM)


def test_two_forces_at_three_places_are_enough() -> None:
    chosen = (PLACE_MM < 200) & ((FORCE_N == 2) | (FORCE_N == 12))
    Characteristic.fit("a", PLACE_MM[chosen][:, None], FORCE_N[chosen], STRAIGHT_MM[chosen], NOISE_MM)
    # A third place whose smaller force is in the noise, with less than two of it, has one force only.
    Characteristic.fit("a", PLACE_MM[chosen][:, None], FORCE_N[chosen], STRAIGHT_MM[chosen], 0.0199)
    with pytest.raises(SceneError, match="at fewer than 3 places"):
        Characteristic.fit("a", PLACE_MM[chosen][:, None], FORCE_N[chosen], STRAIGHT_MM[chosen], 0.021)


STRAIGHT = Characteristic(np.array([-1.0, 0.0, 9.0]), np.array([-2.0, 0.0, 18.0]))
"""Twice what is shown."""


def test_loads_at_a_place_count_by_how_well_they_are_known() -> None:
    place_mm, force_n = np.array([[30.0], [30.0], [10.0], [70.0]]), np.array([2.0, 8.0, 4.0, 5.0])
    shown = np.array([[0.22, 4.0], [0.8, 9.5], [1.0, 9.5], [0.5, 2.0]])
    places, mean, _ = mean_at_places(place_mm, force_n, shown, (STRAIGHT, STRAIGHT), 0.01)
    assert places[:, 0].tolist() == [10, 30, 70]
    assert mean[[0, 2], 0] == pytest.approx([0.5, 0.2])
    # 0.22 and 0.2 per newton, known to 0.01 and 0.0025, and each to 5 % of itself as well.
    weights = 1 / (np.array([0.01, 0.0025]) ** 2 + (0.05 * np.array([0.22, 0.2])) ** 2)
    assert mean[1, 0] == pytest.approx(weights @ [0.22, 0.2] / weights.sum())
    assert np.isnan(mean[:, 1]).tolist() == [True, False, False]
    assert mean[1:, 1] == pytest.approx([4.0, 0.8])


def test_scatter_beyond_noise_is_a_part_of_what_a_sensor_shows() -> None:
    rng, count = np.random.default_rng(4), 400
    place_mm, force_n = np.repeat(np.linspace(0, 90, 10), 40)[:, None], np.full(count, 5.0)
    shown = np.stack([0.5 * (1 + 0.03 * rng.normal(size=count)), 0.5 + 0.01 * rng.normal(size=count)], axis=1)
    _, _, shares = mean_at_places(place_mm, force_n, shown, (STRAIGHT, STRAIGHT), 0.01)
    assert shares[0] == pytest.approx(np.sqrt(0.03**2 - 0.02**2), rel=0.15)
    assert shares[1] < 0.008
    _, _, (alone,) = mean_at_places(place_mm, force_n, shown[:, :1], (STRAIGHT,), 1e-9)
    assert alone == pytest.approx(0.03, rel=0.1)
