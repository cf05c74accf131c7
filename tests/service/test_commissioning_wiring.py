"""Which wiring presses above sensors show: a table of faults, on a beam of the textbook."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from time import process_time

import numpy as np
import pytest

from beamtouch_service.commissioning.pressing import Floats
from beamtouch_service.commissioning.report import Finding
from beamtouch_service.commissioning.verdict import advise, judge_sensors
from beamtouch_service.commissioning.wiring import Explanation, Influence, Press, Wiring, _Fit, _with_one_more
from beamtouch_service.commissioning.wiring import explain as explain_in_steps
from beamtouch_service.samples import Quality

Fault = Callable[[Floats], Floats]

LENGTH_MM = 400.0
RIGIDITY_N_MM2 = 210_000 * 25 * 3**3 / 12
AT_MM = (40.0, 125.0, 250.0, 360.0)
NAMES = ["s1", "s2", "s3", "s4"]
NOISE_MM = 0.009
AIM_MM = (2.0, -3.0, 1.0, -2.0, 3.0, -1.0, 2.0, 0.0)
"""How far beside the sensors the person presses."""
GAINS = np.array([1.02, 0.99, 1.01, 0.98, 1.0, 1.02, 0.99, 1.01])


def deflections(load_mm: Floats, sensors_mm: Sequence[float] = AT_MM) -> Floats:
    """A simply supported beam: w = F b x (L^2 - b^2 - x^2) / (6 E I L) for x <= a, b = L - a, and its mirror image.

    Gere & Timoshenko, Mechanics of Materials, 4th ed., appendix G, case 5.
    """
    a, x = np.reshape(load_mm, (-1, 1)), np.array(sensors_mm)
    a, x = np.where(x <= a, a, LENGTH_MM - a), np.where(x <= a, x, LENGTH_MM - x)
    b = LENGTH_MM - a
    found: Floats = b * x * (LENGTH_MM**2 - b**2 - x**2) / (6 * RIGIDITY_N_MM2 * LENGTH_MM)
    return found


def explain(presses: Sequence[Press], influence: Influence) -> Explanation:
    """Return the explanation, after all steps."""
    found: list[Explanation] = []

    def run() -> Iterator[None]:
        found.append((yield from explain_in_steps(presses, influence)))

    for _ in run():
        pass
    return found[0]


def swap(one: int, other: int, moved: Floats) -> Floats:
    changed = moved.copy()
    changed[[one, other]] = moved[[other, one]]
    return changed


def scale(channel: int, factor: float, moved: Floats) -> Floats:
    changed = moved.copy()
    changed[channel] *= factor
    return changed


def pressed(*faults: Fault, sensors_mm: Sequence[float] = AT_MM, steps: int | None = None) -> Explanation:
    """Judge presses above the first sensors, or all of them, that are measured through these faults."""
    presses = []
    for at_mm, aim_mm, force_n in zip(sensors_mm[:steps], AIM_MM, (9, 12, 7, 14, 10, 8, 13, 11), strict=False):
        moved = force_n * deflections(np.array([at_mm + aim_mm]), sensors_mm)[0] * GAINS[: len(sensors_mm)]
        for fault in faults:
            moved = fault(moved)
        presses.append(Press(np.array([at_mm]), moved, np.full(len(moved), NOISE_MM)))
    return explain(presses, partial(deflections, sensors_mm=sensors_mm))


SWAPPED, INVERTED, DEAD = partial(swap, 0, 3), partial(scale, 1, -1.0), partial(scale, 2, 0.0)
RIGHT = (1, 1, 1, 1)
FAULTS: dict[str, tuple[list[Fault], Wiring, list[str]]] = {
    "right": ([], Wiring((0, 1, 2, 3), RIGHT), []),
    "swapped": ([SWAPPED], Wiring((3, 1, 2, 0), RIGHT), ["The cables of s1 and s4 are swapped."]),
    "neighbours": ([partial(swap, 1, 2)], Wiring((0, 2, 1, 3), RIGHT), ["The cables of s2 and s3 are swapped."]),
    "inverted": ([INVERTED], Wiring((0, 1, 2, 3), (1, -1, 1, 1)), ["s2 moves the wrong way."]),
    "dead": ([DEAD], Wiring((0, 1, 2, 3), (1, 1, 0, 1)), ["s3 does not move (saturated)."]),
    "two pairs": (
        [partial(swap, 0, 1), partial(swap, 2, 3)],
        Wiring((1, 0, 3, 2), RIGHT),
        ["The cables of s1 and s2 are swapped.", "The cables of s3 and s4 are swapped."],
    ),
    "in a circle": (
        [partial(swap, 0, 1), partial(swap, 1, 2)],
        Wiring((1, 2, 0, 3), RIGHT),
        ["Cables are mixed up: the input of s1 has the sensor s2, that of s2 has the sensor s3, that of s3 has"],
    ),
    "reversed": ([lambda moved: moved[::-1]], Wiring((3, 2, 1, 0), RIGHT), ["The channels are in reverse order."]),
    "all inverted": (
        [lambda moved: -moved],
        Wiring((0, 1, 2, 3), (-1, -1, -1, -1)),
        ["s1, s2, s3 and s4 move the wrong way."],
    ),
    "swapped and inverted": (
        [SWAPPED, INVERTED],
        Wiring((3, 1, 2, 0), (1, -1, 1, 1)),
        ["The cables of s1 and s4 are swapped.", "s2 moves the wrong way."],
    ),
    "swapped, inverted and dead": (
        [partial(swap, 0, 1), INVERTED, DEAD],
        Wiring((1, 0, 2, 3), (1, -1, 0, 1)),
        ["The cables of s1 and s2 are swapped.", "s2 moves the wrong way.", "s3 does not move (saturated)."],
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_presses_above_all_sensors_show_the_wiring_for_certain(name: str) -> None:
    faults, wiring, advice = FAULTS[name]
    explanation = pressed(*faults)
    assert explanation.wiring == wiring
    assert (explanation.rivals, explanation.is_explained) == ([], True)
    assert explanation.forces_n == pytest.approx([9, 12, 7, 14], rel=0.12)
    assert explanation.shares == pytest.approx(wiring.signs, abs=0.05)
    found = judge_sensors(explanation, NAMES, {"s3": Quality.SATURATED})
    sentences = advise(explanation, NAMES, found, "beam")
    assert [sentence[: len(begin)] for sentence, begin in zip(sentences, advice, strict=True)] == advice


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "two wirings explain the presses about as well. The next presses may settle it",
)
def test_what_one_press_does_not_tell_apart_is_not_sure() -> None:
    explanation = pressed(SWAPPED, INVERTED, DEAD, steps=1)
    found = judge_sensors(explanation, NAMES, {})
    assert [one.finding for one in found] == [Finding.SWAPPED, Finding.UNSURE, Finding.DEAD, Finding.SWAPPED]
    assert found[1].says == "not sure: moves the wrong way, or moves as s3 should, the wrong way"
    sentences = advise(explanation, NAMES, found, "beam")
    assert [one.partition(" (")[0] for one in sentences[:2]] == [
        "Not sure about s2",
        "The cables of s1 and s4 are swapped. Swap them back.",
    ]
    assert len(sentences) == 3
    assert pressed(SWAPPED, INVERTED, DEAD).rivals == []


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "something else touched the beam or a sensor during a press, or the model is of another beam",
)
def test_a_press_during_which_something_else_moves_a_sensor_is_explained_by_no_wiring() -> None:
    moved = 10 * deflections(np.array(AT_MM))
    moved[2, 1] += 0.5 * moved[2].max()
    presses = [Press(np.array([at_mm]), one, np.full(4, NOISE_MM)) for at_mm, one in zip(AT_MM, moved, strict=True)]
    explanation = explain(presses, deflections)
    assert not explanation.is_explained
    found = judge_sensors(explanation, NAMES, {})
    assert {one.finding for one in found} == {Finding.UNSURE}
    (sentence,) = advise(explanation, NAMES, found, "beam")
    assert sentence.startswith("No wiring explains the presses. Check that each press was above its sensor")


@pytest.mark.parametrize(("channel", "factor"), [(0, 0.5), (0, 1.5), (1, 0.7), (2, 1.5), (3, 0.4)])
def test_a_channel_that_moves_too_little_or_too_much_does_not_pass(channel: int, factor: float) -> None:
    explanation = pressed(partial(scale, channel, factor))
    assert explanation.shares[channel] == pytest.approx(factor, rel=0.15)
    found = judge_sensors(explanation, NAMES, {})
    assert found[channel].finding in {Finding.GAIN, Finding.UNSURE}
    assert f"{100 * explanation.shares[channel]:.0f} %" in found[channel].says
    assert NAMES[channel] in " ".join(advise(explanation, NAMES, found, "beam"))


@pytest.mark.parametrize("faults", [[], [SWAPPED, INVERTED]], ids=["right", "swapped and inverted"])
def test_a_channel_without_values_in_one_press_is_judged_by_the_others(faults: list[Fault]) -> None:
    presses = []
    for step, at_mm in enumerate(AT_MM):
        moved = 10 * deflections(np.array([at_mm]))[0]
        for fault in faults:
            moved = fault(moved)
        if step == 1:
            moved[1] = np.nan
        presses.append(Press(np.array([at_mm]), moved, np.full(4, NOISE_MM)))
    explanation = explain(presses, deflections)
    assert (explanation.is_explained, explanation.rivals) == (True, [])
    assert explanation.wiring == pressed(*faults).wiring
    assert np.abs(explanation.shares) == pytest.approx([1, 1, 1, 1])


def test_a_channel_without_values_in_any_press_is_dead() -> None:
    explanation = pressed(partial(scale, 2, np.nan))
    found = judge_sensors(explanation, NAMES, {"s3": Quality.MISSING})
    assert found[2] == (Finding.DEAD, "does not move (missing)")
    assert [one.finding for one in found].count(Finding.RIGHT) == 3


@pytest.mark.parametrize(
    ("gains", "shares", "finding"),
    [
        ((1.0, 0.7), (1.43, 0.7), Finding.GAIN),
        ((1.0, -0.7), (1.43, -0.7), Finding.GAIN),
        ((1.0, 0.9), (1.11, 0.9), Finding.RIGHT),
        ((1.0, 1.0, 0.72, 0.72), (1.39, 1.39, 0.72, 0.72), Finding.GAIN),
        ((1.0, 1.0, 0.9, 0.9), (1.11, 1.11, 0.9, 0.9), Finding.RIGHT),
    ],
)
def test_of_channels_that_differ_in_halves_neither_half_passes(
    gains: tuple[float, ...], shares: tuple[float, ...], finding: Finding
) -> None:
    sensors_mm = AT_MM if len(gains) == len(AT_MM) else (120.0, 280.0)
    influence = partial(deflections, sensors_mm=sensors_mm)
    moved = 10 * influence(np.array(sensors_mm)) * gains
    noise_mm = np.full(len(gains), NOISE_MM)
    presses = [Press(np.array([at_mm]), one, noise_mm) for at_mm, one in zip(sensors_mm, moved, strict=True)]
    explanation = explain(presses, influence)
    assert explanation.shares == pytest.approx(shares, rel=0.04)
    assert {one.finding for one in judge_sensors(explanation, NAMES[: len(gains)], {})} == {finding}


def test_many_sensors_take_little_longer_than_few() -> None:
    took_s = {}
    for count in (8, 32):
        sensors_mm = np.linspace(15, 385, count).tolist()
        influence = partial(deflections, sensors_mm=sensors_mm)
        moved = 10 * influence(np.array(sensors_mm))
        for fault in (partial(swap, 4, 6), INVERTED, DEAD):
            moved = np.array([fault(one) for one in moved])
        presses = [
            Press(np.array([at_mm]), one, np.full(count, NOISE_MM))
            for at_mm, one in zip(sensors_mm, moved, strict=True)
        ]
        begin_s = process_time()
        explanation = explain(presses, influence)
        took_s[count] = process_time() - begin_s
        assert (explanation.rivals, explanation.wiring.moved) == ([], {4: 6, 6: 4})
        assert explanation.wiring.signs == (1, -1, 0, *[1] * (count - 3))
    # Samples of all surfaces wait meanwhile. To go through all channels for each wiring takes 110 times as long.
    assert took_s[32] < 40 * took_s[8]


@pytest.mark.promise(
    "docs/how-to/commission-on-the-page.md",
    "the sensor sits where the beam hardly bends; nothing can be said of it",
)
def test_of_a_sensor_that_no_press_moves_nothing_is_said() -> None:
    explanation = pressed(sensors_mm=[125.0, 250.0, 399.99])
    assert explanation.is_explained
    found = judge_sensors(explanation, NAMES[:3], {})
    assert [one.finding for one in found] == [Finding.RIGHT, Finding.RIGHT, Finding.UNSURE]
    (sentence,) = advise(explanation, NAMES[:3], found, "beam")
    assert "s3: the presses hardly move it" in sentence


@pytest.mark.parametrize("places", [17, 81])
def test_one_fault_more_is_looked_for_with_the_sums_that_it_would_have_from_the_start(places: int) -> None:
    """A search changes a few terms of its sums for each fault more. They must be those of all terms, for any press."""
    drawn = np.random.default_rng(7)
    table = drawn.normal(0.02, 0.05, (places, 4))
    at_mm = np.zeros(1 if places == 17 else 2)
    fit = _Fit(Press(at_mm, drawn.normal(0.1, 0.3, 4), drawn.uniform(0.004, 0.02, 4)), lambda _at_mm: table)
    wirings = Wiring((0, 1, 2, 3), RIGHT), Wiring((2, 1, 0, 3), (1, -1, 1, 0)), Wiring((1, 3, 2, 0), (-1, 1, 0, 1))
    for wiring in wirings:
        more = list(_with_one_more(wiring))
        assert len(more) == 6 + 2 * np.count_nonzero(wiring.signs)
        assert fit.squares_with_one_more(wiring) == pytest.approx([fit.best(one).square for one in more])


@pytest.mark.parametrize("beside", [0.0, -1.0, 2.0])
def test_a_press_fits_with_the_force_and_the_place_that_leave_least(beside: float) -> None:
    """Least squares of each place by numpy; `beside` deviations of 4 mm is one of the 17 places that are tried."""
    at_mm, noise_mm = 125.0, np.array([0.008, 0.011, 0.009, 0.014])
    moved = 11.0 * deflections(np.array([at_mm + 4.0 * beside]))[0] + np.array([0.01, -0.02, 0.005, 0.03])
    deviation = np.hypot(noise_mm, 0.03 * moved.max())
    squares = {}
    for away in np.linspace(-2.0, 2.0, 17):
        expected = deflections(np.array([at_mm + 4.0 * away]))[0] / deviation
        (force_n,), (left,), _, _ = np.linalg.lstsq(expected[:, None], moved / deviation, rcond=None)
        squares[left + away**2] = force_n, deviation * expected * force_n
    best = _Fit(Press(np.array([at_mm]), moved, noise_mm), deflections).best(Wiring((0, 1, 2, 3), RIGHT))
    force_n, moved_mm = squares[min(squares)]
    assert best.square == pytest.approx(min(squares))
    assert best.force_n == pytest.approx(force_n)
    assert best.moved_mm == pytest.approx(moved_mm)


def test_a_press_is_explained_up_to_a_mean_square_of_two_deviations() -> None:
    """Gains of the channels apart: what is left is that of a fit of each channel to what is expected of it."""
    right, squares = Wiring((0, 1, 2, 3), RIGHT), []
    for beside_mm in np.linspace(0.26, 0.36, 11):
        moved = 10 * deflections(np.array(AT_MM))
        moved[2, 1] += beside_mm
        presses = [Press(np.array([at_mm]), one, np.full(4, NOISE_MM)) for at_mm, one in zip(AT_MM, moved, strict=True)]
        expected = np.array([_Fit(one, deflections).best(right).moved_mm for one in presses])
        gains = (moved * expected).sum(axis=0) / (expected**2).sum(axis=0)
        left = (moved - gains * expected) / np.hypot(NOISE_MM, 0.03 * moved.max(axis=1))[:, None]
        squares.append((left**2).mean(axis=1).max())
        explanation = explain(presses, deflections)
        assert explanation.wiring == right
        assert explanation.is_explained == (squares[-1] <= 4.0), (beside_mm, squares[-1])
    assert max(one for one in squares if one <= 4.0) > 3.5
    assert min(one for one in squares if one > 4.0) < 4.5


@pytest.mark.parametrize(("deviations", "is_seen"), [(2.9, False), (3.1, True)])
def test_nothing_is_said_of_a_channel_that_should_move_by_less_than_three_deviations(
    deviations: float, is_seen: bool
) -> None:
    moved = 9 * deflections(np.array([AT_MM[1]]))[0]
    noise_mm = np.array([NOISE_MM, NOISE_MM, NOISE_MM, moved[3] / deviations])
    shares = explain([Press(np.array([AT_MM[1]]), moved, noise_mm)], deflections).shares
    assert list(np.isfinite(shares)) == [True, True, True, is_seen]
