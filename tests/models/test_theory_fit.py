"""Theories of structures, fitted to few known loads: against cases whose answer is known, and least squares by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.theory_fit import Gains, KnownLoads, Theory, TheoryFit
from beamtouch_models.errors import SceneError

PLACES_MM = np.array([0.0, 100.0, 250.0, 400.0, 500.0])
SHAPE = np.array([[0.0, 5.0], [2.0, 4.0], [5.0, 2.5], [3.0, 1.0], [1.0, 0.2]]) / 100
THEORY = Theory(PLACES_MM, SHAPE)
AT_MM, FORCE_N = np.array([30.0, 120.0, 120.0, 260.0, 410.0, 480.0]), np.array([4.0, 9.0, 3.0, 5.0, 8.0, 6.0])
GAIN = np.array([1.3, 0.8])
NOISE_MM = 0.003


def known(factor: Floats | float = 1.0, shown_mm: Floats | float = 0.0) -> KnownLoads:
    """Return loads under which sensors show the theory times their gain and a factor, and something more."""
    by_theory = THEORY.at(AT_MM)
    return KnownLoads(AT_MM, FORCE_N, FORCE_N[:, None] * by_theory * GAIN * factor + shown_mm, by_theory)


def test_a_theory_takes_its_table_in_any_order_and_the_mean_of_what_is_there_twice() -> None:
    order = [3, 0, 2, 4, 1, 3]
    table = SHAPE[order] + np.array([[0.01], [0], [0], [0], [0], [0.03]])
    theory = Theory.of(PLACES_MM[order], table)
    assert theory.position_mm.tolist() == PLACES_MM.tolist()
    assert theory.influence == pytest.approx(SHAPE + np.array([[0], [0], [0], [0.02], [0]]))
    assert THEORY.at(PLACES_MM) == pytest.approx(SHAPE)
    assert THEORY.at(np.array([-50.0, 600.0])) == pytest.approx(SHAPE[[0, -1]])
    between = THEORY.at(np.linspace(250, 500, 40))
    assert np.all(np.diff(between, axis=0) < 0)


def test_gains_of_loads_that_follow_the_theory_are_theirs() -> None:
    gains = Gains.fit(known(), NOISE_MM, curved=False)
    assert gains.gain == pytest.approx(GAIN)
    value, noise = gains.read(known(), NOISE_MM)
    assert value == pytest.approx(THEORY.at(AT_MM))
    assert noise == pytest.approx(NOISE_MM / (FORCE_N[:, None] * GAIN))
    assert gains.show(known()) == pytest.approx(known().shown_mm)
    assert Gains(-GAIN, ()).read(known(), NOISE_MM)[1] == pytest.approx(noise)


def test_gains_weigh_loads_by_noise_and_by_what_a_theory_usually_misses() -> None:
    factor = 1 + np.array([[0.1, -0.05], [0.02, 0.1], [0, 0], [-0.1, 0.03], [0.05, 0], [0, -0.1]])
    loads = known(factor)
    theory, value = loads.by_theory, loads.shown_mm / FORCE_N[:, None]
    mean_square = (theory**2).mean(axis=0)
    roughly = (value * theory).sum(axis=0) / (theory**2).sum(axis=0)
    # A tenth of it, and a tenth of its mean square.
    variance = (NOISE_MM / FORCE_N[:, None]) ** 2 + (0.1 * roughly) ** 2 * (theory**2 + mean_square)
    wanted = (value * theory / variance).sum(axis=0) / (theory**2 / variance).sum(axis=0)
    assert Gains.fit(loads, NOISE_MM, curved=False).gain == pytest.approx(wanted)


def test_what_a_theory_misses_is_judged_where_a_place_is_left_out() -> None:
    factor = 1 + np.array([[0.1, -0.05], [0.02, 0.1], [0, 0], [-0.1, 0.03], [0.05, 0], [0, -0.1]])
    loads = known(factor)
    fit = TheoryFit.of(THEORY, loads, NOISE_MM, curved=False)
    assert fit.gains.gain == pytest.approx(Gains.fit(loads, NOISE_MM, curved=False).gain)
    misses = np.geomspace(0.002, 1, 28)
    for sensor in (0, 1):
        theory = loads.by_theory[:, sensor]
        off, noise = np.empty((2, 6))
        for place in np.unique(AT_MM):
            there = place == AT_MM
            gain = Gains.fit(loads.where(~there), NOISE_MM, curved=False).gain[sensor]
            off[there] = loads.shown_mm[there, sensor] / FORCE_N[there] / gain - theory[there]
            noise[there] = NOISE_MM / FORCE_N[there] / gain
        largest = np.sqrt((theory**2).mean())
        chances = np.array(
            [
                [
                    stats.norm.pdf(
                        off, scale=np.sqrt(noise**2 + (share * theory) ** 2 + (constant * largest) ** 2)
                    ).prod()
                    for constant in misses
                ]
                for share in misses
            ]
        )
        chances /= chances.sum()
        share = np.sqrt(chances.sum(axis=1) @ misses**2)
        constant = np.sqrt(chances.sum(axis=0) @ misses**2) * largest
        assert (fit.share[sensor], fit.constant[sensor]) == (pytest.approx(share), pytest.approx(constant))
        deviation = np.sqrt(noise**2 + (share * theory) ** 2 + constant**2)
        assert fit.missed[:, sensor] == pytest.approx(off / deviation)
    place = np.array([[60.0], [333.0]])
    mean, deviation = fit.at(place)
    shape = THEORY.at(place[:, 0])
    assert mean == pytest.approx(fit.gains.gain * shape)
    assert deviation == pytest.approx(fit.gains.gain * np.hypot(fit.share * shape, fit.constant))
    assert fit.repeatability.tolist() == [0, 0]


def test_a_drawn_structure_departs_smoothly_and_as_far_as_the_fit_says() -> None:
    rng, place = np.random.default_rng(3), np.array([[0.0], [5.0], [250.0], [500.0]])
    fit = TheoryFit.of(THEORY, known(1 + 0.05 * rng.normal(size=(6, 2))), NOISE_MM, curved=False)
    mean, deviation = fit.at(place)
    off = np.array([(fit.draw(place, rng) - mean) / deviation for _ in range(500)])
    assert np.abs(off.mean(axis=0)).max() < 0.15
    assert np.abs(off.std(axis=0) - 1).max() < 0.12
    near, middle, far = (np.corrcoef(off[:, 0, 0], off[:, other, 0])[0, 1] for other in (1, 2, 3))
    # By the kernel of order 3/2, with a length of 0.3 of the span: 1 + s to the power of -s, s = sqrt(3) d / 0.3.
    for found, apart in ((near, 0.01), (middle, 0.5), (far, 1.0)):
        scaled = 3**0.5 * apart / 0.3
        assert found == pytest.approx((1 + scaled) * np.exp(-scaled), abs=0.12)


def test_loads_that_follow_the_theory_are_taken() -> None:
    loads = known(1.0, 0.001 * np.random.default_rng(1).normal(size=(6, 2)))
    TheoryFit.of(THEORY, loads, NOISE_MM, curved=False).check(loads, NOISE_MM, ("a", "b"), "mm")


def test_a_theory_of_another_sign_or_of_another_structure_is_refused() -> None:
    against = known(np.array([1.0, -1.0]))
    with pytest.raises(SceneError, match="b shows the opposite of what it says; change the sign of"):
        TheoryFit.of(THEORY, against, NOISE_MM, curved=False).check(against, NOISE_MM, ("a", "b"), "mm")
    still = replace(TheoryFit.of(THEORY, known(), NOISE_MM, curved=False), gains=Gains(np.array([0.0, 1.0]), ()))
    with pytest.raises(SceneError, match="a shows the opposite of what it says"):
        still.check(known(), NOISE_MM, ("a", "b"), "mm")
    swapped = known()
    swapped = KnownLoads(AT_MM, FORCE_N, swapped.shown_mm[:, ::-1], swapped.by_theory)
    fit = TheoryFit.of(THEORY, swapped, NOISE_MM, curved=False)
    _, deviation = fit.at(AT_MM[:, None])
    part = np.sqrt(((deviation / fit.gains.gain) ** 2).mean(axis=0) / (swapped.by_theory**2).mean(axis=0))
    worst = int(part.argmax())
    with pytest.raises(SceneError, match=rf"^measured.theory: it misses what {'ab'[worst]} shows by ") as refused:
        fit.check(swapped, NOISE_MM, ("a", "b"), "mm")
    told = float(str(refused.value).split("shows by ")[1].split(" %")[0])
    assert told == pytest.approx(100 * part[worst], rel=0.05)
    assert told > 30


def many(wrong: float) -> KnownLoads:
    """Return nine loads, of which the fifth is wrong by so much of what the second sensor shows."""
    place_mm, force_n = np.linspace(20, 480, 9), np.array([4.0, 9.0, 3.0, 5.0, 8.0, 6.0, 4.0, 7.0, 5.0])
    by_theory = THEORY.at(place_mm)
    shown = force_n[:, None] * by_theory * GAIN * (1 + 0.005 * np.random.default_rng(2).normal(size=(9, 2)))
    shown[4, 1] *= 1 + wrong
    return KnownLoads(place_mm, force_n, shown, by_theory)


def test_a_load_that_contradicts_the_others_is_named_with_what_they_say() -> None:
    loads = many(0.6)
    with pytest.raises(SceneError) as refused:
        TheoryFit.of(THEORY, loads, NOISE_MM, curved=False).check(loads, NOISE_MM, ("a", "b"), "V")
    said = str(refused.value)
    assert said.startswith("measured.influence: under the load at 250 mm with 8 N, b shows 0.25")
    assert said.endswith("; measure it again, or take it out")
    by_others = float(said.partition("it should show ")[2].partition(";")[0])
    assert by_others == pytest.approx(0.16, rel=0.02)  # 8 N times 0.025 times 0.8


@pytest.mark.parametrize(("wrong", "count"), [(0.04, 9), (0.6, 8)])
def test_a_load_that_is_a_little_off_or_one_of_few_is_not_named(wrong: float, count: int) -> None:
    """A tenth of the influence, and eight others: less tells nothing about one load."""
    loads = many(wrong).where(np.arange(9) >= 9 - count)
    TheoryFit.of(THEORY, loads, NOISE_MM, curved=False).check(loads, NOISE_MM, ("a", "b"), "V")


def test_loads_that_do_not_tell_characteristics_are_refused() -> None:
    loads = known(1.0, np.array([0.0, 0.0]))
    loads.check_curved(("a", "b"), NOISE_MM)
    few = loads.where(np.arange(6) > 0)
    with pytest.raises(
        SceneError,
        match="a shows more than its noise under 5 loads at 4 places, and its characteristic needs 6 at 3; measure",
    ):
        few.check_curved(("a", "b"), NOISE_MM)
    # Of the second sensor, the load at 480 mm is within twice the noise.
    with pytest.raises(SceneError, match="b shows more than its noise under 5 loads at 4 places"):
        loads.check_curved(("a", "b"), float(loads.shown_mm[-1, 1]) / 1.99)
    place_mm = np.array([100.0, 250.0] * 4)
    two = KnownLoads(
        place_mm, np.arange(1.3, 9.0), np.arange(1.3, 9.0)[:, None] * THEORY.at(place_mm), THEORY.at(place_mm)
    )
    with pytest.raises(SceneError, match="under 8 loads at 2 places"):
        two.check_curved(("a", "b"), NOISE_MM)


def test_curved_sensors_are_read_as_straight_ones() -> None:
    place_mm, force_n = np.repeat([50.0, 200.0, 350.0], 4), np.tile([2.0, 4.0, 7.0, 10.0], 3)
    by_theory = THEORY.at(place_mm)
    straight = force_n[:, None] * by_theory
    shown = straight.max(axis=0) * (straight / straight.max(axis=0)) ** 0.8
    loads = KnownLoads(place_mm, force_n, shown, by_theory)
    gains = Gains.fit(loads, 1e-4, curved=True)
    assert gains.gain == pytest.approx([1, 1], rel=0.01)
    value, noise = gains.read(loads, 1e-4)
    assert value == pytest.approx(by_theory, rel=0.02)
    assert gains.show(loads) == pytest.approx(shown, rel=0.02)
    slope = 1.25 * (shown / straight.max(axis=0)) ** 0.25
    assert noise[1:4] == pytest.approx((1e-4 * slope / force_n[:, None])[1:4], rel=0.1)
