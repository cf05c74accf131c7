"""The fit of damped sinusoids against Gauss-Newton steps of all parameters at once, with derivatives by differences."""

import math

import numpy as np
import pytest

from beamtouch_models.filters import FloatArray
from beamtouch_models.filters.jitter import ALIKE, refit, whitened
from beamtouch_models.filters.sinusoids import (
    AMPLITUDE,
    DAMPING,
    HIGHEST,
    HIGHEST_UNEVEN,
    MAX_DAMPING,
    Band,
    Fit,
    Poles,
    fit,
    predicted,
    refine,
    seek,
)

ROWS, CHANNELS = 37, 3
BAND = Band(0.15)
POLES = Poles(np.array([0.013, 0.021]), np.array([0.62, 1.7]))
"""Of the readings."""
NEAR = Poles(np.array([0.016, 0.017]), np.array([0.63, 1.68]))
"""Where a fit begins."""
SINGLE = np.arange(1.0 - ROWS, 1.0)
TIMES = {
    "even": SINGLE,
    "uneven": SINGLE + np.sin(7.0 * np.arange(ROWS)) / 5 - math.sin(7.0 * (ROWS - 1)) / 5,
    "means of three": SINGLE[:, np.newaxis] + np.array([-0.35, 0.0, 0.3]),
}


def said(parameters: FloatArray, poles: int, slopes: bool, times: FloatArray) -> FloatArray:
    """Return what coefficients (columns, channels), decays and frequencies say of times, (times, channels)."""
    coefficients = parameters[: -2 * poles or None].reshape(-1, CHANNELS)
    decay, frequency = parameters[len(parameters) - 2 * poles :].reshape(2, poles)
    columns = [np.ones(len(times))]
    each = times if times.ndim > 1 else times[:, np.newaxis]
    if slopes:
        columns.append(each.mean(axis=1) / len(times))
    for wave in (np.cos, np.sin):
        columns += [(np.exp(-d * each) * wave(w * each)).mean(axis=1) for d, w in zip(decay, frequency, strict=True)]
    values: FloatArray = np.stack(columns, axis=1) @ coefficients
    return values


def drawn(times: FloatArray, slopes: bool, seed: int = 3, size: float = 25.0) -> FloatArray:
    """Return readings of a beam that swings, in units of their noise."""
    random = np.random.default_rng(seed)
    coefficients = random.normal(0.0, size, (5 + slopes, CHANNELS))
    parameters = np.concatenate([coefficients.ravel(), *POLES])
    return said(parameters, 2, slopes, times) + random.standard_normal((len(times), CHANNELS))


def parameters_of(of: Fit) -> FloatArray:
    return np.concatenate([of.coefficients.ravel(), *of.poles])


def priors_of(of: Fit) -> FloatArray:
    """Return the precision of each parameter before anything is measured."""
    count = len(of.poles.decay)
    return np.concatenate(
        [
            np.full(of.coefficients.size, AMPLITUDE**-2.0),
            (DAMPING * of.poles.frequency) ** -2.0,
            np.full(count, math.pi**-2.0),
        ]
    )


def centred(of: Fit) -> FloatArray:
    """Return how far each parameter is from where its prior has it: the frequencies are where they begin."""
    away = parameters_of(of)
    away[away.size - len(of.poles.decay) :] = 0.0
    return away


def slopes_of(of: Fit, times: FloatArray) -> FloatArray:
    """Return how values (times, channels, parameters) change with the parameters."""
    parameters, count, changes = parameters_of(of), len(of.poles.decay), []
    for unit in 1e-5 * np.eye(len(parameters)):
        more, less = (said(parameters + way * unit, count, of.slopes, times) for way in (1, -1))
        changes.append((more - less) / 2e-5)
    return np.stack(changes, axis=2)


@pytest.mark.parametrize("slopes", [False, True])
@pytest.mark.parametrize("kind", TIMES)
@pytest.mark.parametrize("size", [25.0, 0.6])
def test_a_step_of_the_poles_alone_is_that_of_all_parameters_together(kind: str, slopes: bool, size: float) -> None:
    times = TIMES[kind]
    values = drawn(times, slopes, size=size)
    found = fit(times, values, NEAR, BAND, slopes=slopes)
    changes, prior, away = slopes_of(found, times).reshape(values.size, -1), priors_of(found), centred(found)
    left = (values - said(parameters_of(found), 2, slopes, times)).ravel()
    information = changes.T @ changes + np.diag(prior)
    force = changes.T @ left - prior * away
    linear = found.coefficients.size
    # The coefficients are the best ones for these poles.
    assert np.abs(force[:linear]).max() < 1e-3
    step, spread = np.linalg.solve(information, force), np.linalg.inv(information)
    assert found.following.decay == pytest.approx(NEAR.decay + step[linear : linear + 2], abs=1e-5)
    assert found.following.frequency == pytest.approx(NEAR.frequency + step[linear + 2 :], abs=1e-5)
    assert found.constant == pytest.approx(found.coefficients[0] + step[:CHANNELS], abs=1e-3)
    assert found.covariance == pytest.approx(spread[:CHANNELS, :CHANNELS], rel=1e-4, abs=1e-6)
    assert found.square == pytest.approx(left @ left + prior @ away**2, rel=1e-6)
    assert found.promised == pytest.approx(found.square - force @ step, rel=1e-4)
    assert (found.rows, found.parameters) == (ROWS, linear + 4)
    assert found.freedom == values.size - found.parameters
    assert predicted(found, times) == pytest.approx(said(parameters_of(found), 2, slopes, times), abs=1e-9)


@pytest.mark.parametrize("slopes", [False, True])
def test_a_fit_without_poles_is_a_regression(slopes: bool) -> None:
    values = drawn(SINGLE, slopes)
    found = fit(SINGLE, values, Poles.none(), BAND, slopes=slopes)
    columns = np.stack([np.ones(ROWS), SINGLE / ROWS][: 1 + slopes], axis=1)
    expected, left, *_ = np.linalg.lstsq(columns, values)
    assert found.coefficients == pytest.approx(expected, rel=1e-4)
    assert found.constant == pytest.approx(expected[0], rel=1e-4)
    assert found.square == found.promised == pytest.approx(left.sum(), rel=1e-4)
    assert found.covariance == pytest.approx(np.linalg.inv(columns.T @ columns)[0, 0] * np.eye(CHANNELS), rel=1e-4)
    assert (found.parameters, found.freedom) == ((1 + slopes) * CHANNELS, (ROWS - 1 - slopes) * CHANNELS)
    assert found.turns == 0.0


def test_a_step_that_leaves_the_band_ends_at_its_edge_and_promises_what_that_leaves() -> None:
    band, start = Band(0.15, 0.61), Poles(np.array([0.0]), np.array([0.6]))
    values = said(
        np.concatenate([[4.0, -7.0, 5.0, 30.0, 21.0, -16.0, 9.0, 12.0, 5.0], [-0.02, 0.66]]), 1, False, SINGLE
    )
    found = fit(SINGLE, values, start, band, slopes=False)
    assert found.following.decay == 0.0
    assert found.following.frequency == 0.61
    changes, prior, away = slopes_of(found, SINGLE).reshape(values.size, -1), priors_of(found), centred(found)
    moved = np.array([0.0, 0.61 - 0.6])
    left = (values - said(parameters_of(found), 1, False, SINGLE)).ravel() - changes[:, -2:] @ moved
    # The coefficients follow the poles.
    rows = np.concatenate([changes[:, :-2], np.diag(prior[:-2] ** 0.5)])
    wanted = np.concatenate([left, -(prior[:-2] ** 0.5) * away[:-2]])
    linear, square, *_ = np.linalg.lstsq(rows, wanted)
    assert found.constant == pytest.approx(found.coefficients[0] + linear[:CHANNELS], abs=1e-4)
    assert found.promised == pytest.approx(square[0] + moved[1] ** 2 / math.pi**2, rel=1e-4)


def test_the_swing_of_a_fit_is_told_by_its_amplitudes() -> None:
    coefficients = np.array([[9.0, 8.0], [1.0, 2.0], [3.0, -1.0], [2.0, 4.0], [-2.0, 5.0], [1.0, 3.0]])
    of = fit(SINGLE, np.zeros((ROWS, 2)), POLES, BAND, slopes=True)._replace(coefficients=coefficients)
    assert of.swing == pytest.approx(1 + 4 + 9 + 1 + 4 + 16 + 4 + 25 + 1 + 9)
    # The slope is none of the swings: cosines and sines of the first pole, 10 and 29, of the second one, 20 and 10.
    expected = math.sqrt((39 * 0.62**2 + 30 * 1.7**2) / 69)
    assert of.frequency == pytest.approx(expected)
    assert of.turns == pytest.approx(ROWS / (2 * math.pi / 0.62))


@pytest.mark.parametrize(
    ("decay", "frequency", "expected"),
    [
        (-0.1, 1.0, (0.0, 1.0)),
        (0.05, 0.1, (MAX_DAMPING * 0.3, 0.3)),
        (0.03, 0.1, (0.03, 0.3)),
        (9.0, 2.0, (MAX_DAMPING * 2.0, 2.0)),
        # The damping of a swing that is faster than the readings is that of a slower one, which looks like it.
        (9.0, 5.0, (MAX_DAMPING * HIGHEST, 5.0)),
        (0.2, 99.0, (0.2, 6.0)),
    ],
)
def test_poles_stay_within_their_band(decay: float, frequency: float, expected: tuple[float, float]) -> None:
    poles = Poles(np.array([decay]), np.array([frequency])).within(Band(0.3, 6.0))
    assert (poles.decay.item(), poles.frequency.item()) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("times", "highest", "usual"),
    [
        (np.arange(-8.0, 1.0), HIGHEST, 1.0),
        # Some readings are lost.
        (np.array([-9.0, -7, -6, -5, -2, -1, 0]), HIGHEST, 1.0),
        # All at another rate than the nominal one: as good as even.
        (1.3 * np.array([-9.0, -7, -6, -5, -2, -1, 0]), HIGHEST, 1.0),
        (np.arange(-8.0, 1.0) + np.array([0, 0.01, 0, -0.01, 0, 0, 0.01, 0, 0]), HIGHEST, 1.0),
        (np.array([-8.0, -7.0, -5.7, -5.2, -4.0, -2.8, -2.0, -0.9, 0.0]), HIGHEST_UNEVEN, 1.05),
        # Stamps that went back.
        (np.array([0.0, -1.1, -2.4, -3.1]), HIGHEST, 1.0),
        # Means of two readings each, 1.5 apart: single readings are uneven.
        (np.array([[-4.0, -3.75], [-3.0, -2.4], [-2.0, -1.75], [-1.0, -0.2]]), HIGHEST_UNEVEN, 1.2),
        (np.array([[-4.0, -3.5], [-3.0, -2.5], [-2.0, -1.5], [-1.0, -0.5]]), HIGHEST, 1.0),
    ],
)
def test_uneven_readings_tell_faster_swings(times: FloatArray, highest: float, usual: float) -> None:
    band = Band.of(times, 0.2)
    assert band.lowest == 0.2
    assert band.highest == highest
    assert band.usual == pytest.approx(usual)


@pytest.mark.parametrize(
    ("frequency", "usual", "still"),
    [
        # A turn between two readings looks like a load, as do two, within the lowest frequency.
        (2 * math.pi, 1.0, True),
        (2 * math.pi - 0.19, 1.0, True),
        (2 * math.pi - 0.21, 1.0, False),
        (2 * math.pi + 0.19, 1.0, True),
        (4 * math.pi + 0.19, 1.0, True),
        (4 * math.pi + 0.21, 1.0, False),
        (2 * math.pi / 1.3, 1.3, True),
        (2 * math.pi / 1.3 - 0.19, 1.3, True),
        (2 * math.pi / 1.3 - 0.21, 1.3, False),
        (2 * math.pi / 1.3, 1.0, False),
        (0.1, 1.0, False),
        (math.pi, 1.0, False),
    ],
)
def test_a_swing_that_turns_once_between_readings_looks_like_a_load(
    frequency: float, usual: float, still: bool
) -> None:
    assert Band(0.2, HIGHEST_UNEVEN, usual).seem_still(np.array([1.0, frequency])).tolist() == [False, still]


@pytest.mark.parametrize("slopes", [False, True])
@pytest.mark.parametrize("frequency", [0.21, 0.5, 1.3, 2.2, 2.9])
def test_the_pole_that_is_sought_is_that_of_the_swing_that_a_fit_leaves(frequency: float, slopes: bool) -> None:
    times = np.arange(-29.0, 1.0)
    wave = np.stack([3.0 * np.cos(frequency * times), 8.0 * np.sin(frequency * times), times * slopes - 40.0], axis=1)
    old = Poles(np.array([0.02]), np.array([1.75]))
    found = fit(times, wave, old, BAND, slopes=slopes)
    poles = seek(found, times, wave, BAND)
    assert poles.decay[0] == 0.02
    assert poles.frequency[0] == 1.75
    assert abs(poles.frequency[1] - frequency) < 0.6 * (math.pi - 0.15) / 29
    assert 0 < poles.decay[1] < 0.01


@pytest.mark.parametrize(("readings", "tried"), [(7, 20), (33, 33), (90, 64)])
@pytest.mark.parametrize("slopes", [False, True])
def test_the_frequency_that_explains_most_is_sought_among_as_many_as_there_are_readings(
    readings: int, tried: int, slopes: bool
) -> None:
    times, frequencies = np.arange(1.0 - readings, 1.0), np.linspace(0.15, 0.99 * math.pi, tried)
    for seed in range(8):
        values = np.random.default_rng(seed).standard_normal((readings, 2))
        found = fit(times, values, Poles.none(), BAND, slopes=slopes)
        base, squares = [np.ones(readings), times][: 1 + slopes], []
        for frequency in frequencies:
            columns = np.stack([*base, np.cos(frequency * times), np.sin(frequency * times)], axis=1)
            left = values - columns @ np.linalg.lstsq(columns, values)[0]
            squares.append(float((left**2).sum()))
        sought = seek(found, times, values, BAND).frequency[0]
        assert sought == pytest.approx(frequencies[int(np.argmin(squares))], rel=1e-9)


def test_a_faster_swing_than_even_readings_tell_is_found_where_they_are_uneven() -> None:
    times = TIMES["uneven"]
    for frequency in (3.9, 8.1, 11.0):
        wave = np.stack([3.0 * np.cos(frequency * times), 8.0 * np.sin(frequency * times)], axis=1)
        band = Band.of(times, 0.15)
        none = fit(times, wave, Poles.none(), band, slopes=False)
        assert seek(none, times, wave, band).frequency[0] == pytest.approx(frequency, abs=0.09)
    # No frequency is left where all look like a load.
    assert len(seek(none, times, wave, Band(3.2, HIGHEST_UNEVEN)).frequency) == 0


@pytest.mark.parametrize("seed", range(3))
def test_steps_end_at_the_least_square_from_near_and_from_far(seed: int) -> None:
    values = drawn(SINGLE, slopes=True, seed=seed)
    near = refine(SINGLE, values, POLES, BAND, slopes=True, steps=9)
    assert near.square < 1.6 * near.freedom
    begun = fit(SINGLE, values, Poles(POLES.decay * 3, POLES.frequency * [1.1, 0.95]), BAND, slopes=True)
    far = refine(SINGLE, values, begun.poles, BAND, slopes=True, steps=9)
    assert far.square == pytest.approx(near.square, rel=1e-3)
    squares = [refine(SINGLE, values, begun.poles, BAND, slopes=True, steps=steps).square for steps in range(9)]
    assert squares[0] == begun.square
    assert squares == sorted(squares, reverse=True)


@pytest.mark.parametrize("slopes", [False, True])
@pytest.mark.parametrize("kind", ["even", "uneven", "means of three"])
def test_a_step_for_stamps_that_are_off_is_that_of_generalized_least_squares(kind: str, slopes: bool) -> None:
    times, jitter, most = TIMES[kind], 0.07, 0.3
    values = drawn(times, slopes)
    begun = fit(times, values, NEAR, BAND, slopes=slopes)._replace(jitter=jitter)
    found, square = refit(begun, times, values, BAND, most)

    def moving(of: Fit) -> FloatArray:
        """Return how fast the beam moves, (times, channels)."""
        later, sooner = (said(parameters_of(of), 2, slopes, times + late) for late in (1e-5, -1e-5))
        return (later - sooner) / 2e-5

    def weights(of: Fit) -> FloatArray:
        """Return the inverse covariance of each reading: noise, and the speed of the beam times what stamps are off."""
        way = moving(of)
        inverse: FloatArray = np.asarray(
            np.linalg.inv(np.eye(CHANNELS) + of.jitter**2 * way[:, :, np.newaxis] * way[:, np.newaxis]), np.float64
        )
        return inverse

    changes, prior, away = slopes_of(begun, times), priors_of(begun), centred(begun)
    left = values - said(parameters_of(begun), 2, slopes, times)
    information = np.einsum("tcp,tcd,tdq->pq", changes, weights(begun), changes)
    information += np.diag(ALIKE * np.diag(information) + prior)
    force = np.einsum("tcp,tcd,td->p", changes, weights(begun), left) - prior * away
    step = np.linalg.solve(information, force)
    # That the mean of readings changes with its mean time is nearly true.
    rough = 1e-2 if kind == "means of three" else 2e-4
    assert parameters_of(found) == pytest.approx(parameters_of(begun) + step, rel=rough, abs=rough)
    assert found.constant == pytest.approx(found.coefficients[0])
    assert found.following == found.poles
    assert found.covariance == pytest.approx(np.linalg.inv(information)[:CHANNELS, :CHANNELS], rel=rough, abs=1e-5)
    before = float(np.einsum("tc,tcd,td->", left, weights(begun), left) + prior @ away**2)
    assert found.square == pytest.approx(before, rel=1e-5)
    assert found.promised == pytest.approx(before - force @ step, rel=1e-4)
    assert (found.rows, found.parameters) == (ROWS, len(force))
    assert found.freedom == values.size - len(force)
    # What is left along the way of the beam, beyond noise, over its speed.
    way, after = moving(found), values - said(parameters_of(found), 2, slopes, times)
    speed = np.linalg.norm(way, axis=1)
    late = (way * after).sum(axis=1) / speed
    expected = math.sqrt(max(0.0, float((late**2 - 1).sum())) / float((speed**2).sum()))
    assert found.jitter == pytest.approx(np.clip(expected, 0.002, most), rel=1e-4)
    assert square == pytest.approx(float(np.einsum("tc,tcd,td->", after, weights(found), after)), rel=1e-5)
    white = whitened(found, times, after)
    assert (white**2).sum(axis=1) == pytest.approx(np.einsum("tc,tcd,td->t", after, weights(found), after), rel=1e-5)


def test_stamps_are_off_by_no_more_than_is_allowed_and_by_a_little_at_least() -> None:
    values = drawn(SINGLE, slopes=False)
    begun = refine(SINGLE, values, NEAR, BAND, slopes=False, steps=3)
    assert whitened(begun, SINGLE, values) is values  # exact stamps change nothing
    speedy = begun._replace(jitter=0.01)
    exact = predicted(begun, SINGLE)
    assert refit(speedy, SINGLE, exact, BAND, 0.3)[0].jitter == 0.002
    off = exact + 30 * np.random.default_rng(1).standard_normal(exact.shape)
    assert refit(speedy, SINGLE, off, BAND, 0.03)[0].jitter == 0.03
    assert refit(begun, SINGLE, off, BAND, 0.03)[0].jitter == 0.03


@pytest.mark.parametrize("size", [25.0, 0.3, 0.0])
def test_what_is_left_is_in_units_of_noise_and_stamps_however_slowly_the_beam_moves(size: float) -> None:
    """By the covariance of each reading: noise of 1, and late stamps along the way of the beam."""
    of = fit(SINGLE, drawn(SINGLE, slopes=True, size=25.0), NEAR, BAND, slopes=True)
    of = of._replace(coefficients=of.coefficients * size / 25.0, jitter=0.9)
    left = np.random.default_rng(4).standard_normal((ROWS, CHANNELS))
    later, sooner = (said(parameters_of(of), 2, True, SINGLE + late) for late in (1e-5, -1e-5))
    way = (later - sooner) / 2e-5
    covariance = np.eye(CHANNELS) + 0.9**2 * way[:, :, np.newaxis] * way[:, np.newaxis]
    expected = np.einsum("tc,tc->t", left, np.linalg.solve(covariance, left[..., np.newaxis])[..., 0])
    assert (whitened(of, SINGLE, left) ** 2).sum(axis=1) == pytest.approx(expected, rel=1e-5)
