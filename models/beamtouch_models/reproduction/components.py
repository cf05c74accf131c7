"""Figures 2, 3, 4 and 7: the sensor's characteristic, and the principal components of the beam.

The components are those of equal pitch, under noise, and of optimised layouts.
"""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.charts import Chart, Series
from beamtouch_models.placement.components import Components, principal_components
from beamtouch_models.reproduction.finding import Figure, Row, compared, rounded
from beamtouch_models.reproduction.paper import LOADS_MM, MAX_DEFLECTION, SCENE, dimensionless, equal_pitch_mm
from beamtouch_models.surface import Surface
from beamtouch_models.world import counts_of_output, output_of_gap


def figure_2() -> Figure:
    """Return figure 2: the output of the rig's sensor over the gap, and its deviation from a line from 1 to 4 mm."""
    sensor = Surface.of(SCENE).sensor
    full_scale = 2**sensor.adc_bits - 1
    gap = np.linspace(0.0, 5.0, 501)
    output = counts_of_output(sensor, output_of_gap(sensor, gap)) / full_scale * 100
    stated = (gap >= 1) & (gap <= 4)
    line = np.polynomial.Polynomial.fit(gap[stated], output[stated], 1)
    departure = np.abs(output - line(gap))
    straight = gap[departure < 0.01]
    row = compared(
        "fig. 2: linear range of the sensor",
        "1 to 4 mm",
        f"{straight[0]:.3g} to {straight[-1]:.3g} mm (by construction of the rig's sensor); off the line by "
        f"{departure[stated].max():.1g} % of the scale",
        agrees=bool(abs(straight[0] - 1) < 0.1 and abs(straight[-1] - 4) < 0.1),
        why="the rig's sensor is not linear over that range",
    )
    chart = Chart(
        "Output of the proximity sensor over its gap: straight from 1 to 4 mm, levelling off beyond",
        "gap, mm",
        "output, % of the scale",
        [
            Series("output of the rig's sensor", rounded(gap), rounded(output)),
            Series(
                "straight from 1 to 4 mm, as the paper states",
                [0.5, 4.5],
                rounded(line(np.array([0.5, 4.5]))),
                1,
                "dashed",
            ),
        ],
    )
    results = {
        "gap_mm": rounded(gap[::10]),
        "output_percent": rounded(output[::10]),
        "largest_departure_percent": rounded(float(departure[stated].max())),
    }
    return Figure(2, "sensor", "A characteristic of the proximity sensors.", chart, results, (row,))


DISCERNIBLE = 0.005
"""A curve within less than this share of a plot's height looks like a flat line: half a millimetre of 100 mm."""
SIZE = "size, W l³/(EI)"


def figure_3() -> Figure:
    """Return figure 3: the components of eight equally pitched sensors."""
    found = principal_components(dimensionless(equal_pitch_mm(8)))
    spans = np.ptp(found.transformed, axis=0)
    discernible = int((spans / spans[0] >= DISCERNIBLE).sum())
    curves = [Series(f"component {k + 1}", LOADS_MM.tolist(), rounded(found.transformed[:, k]), k) for k in range(4)]
    says = "The four largest components of eight equally pitched sensors over the position of the load"
    results = {
        "eigenvalues": rounded(found.eigenvalues),
        "eigenvalues_over_first": rounded(found.eigenvalues / found.eigenvalues[0]),
        "discernible": discernible,
        "load_mm": LOADS_MM[::6].tolist(),
        "components": [rounded(found.transformed[::6, k]) for k in range(4)],
    }
    chart = Chart(says, "position of the load, mm", SIZE, curves)
    return Figure(3, "components", f"{says}.", chart, results, (*_sizes(found, spans, discernible), *_meanings(found)))


def _sizes(found: Components, spans: Floats, discernible: int) -> tuple[Row, Row]:
    ratio = found.eigenvalues / found.eigenvalues[0]
    return (
        compared(
            "fig. 3: components of eight that are visible on one scale",
            "4",
            f"{discernible} (peak to peak over the first: {', '.join(f'{x:.2g}' for x in (spans / spans[0])[:5])})",
            agrees=discernible == 4,
            why=f"with a threshold of {DISCERNIBLE:g} of the plot's height",
        ),
        Row(
            "fig. 3: eigenvalues over the first",
            "",
            f"{ratio[1]:.4f}, {ratio[2]:.3g}, {ratio[3]:.3g}, {ratio[4]:.3g}",
            "not stated",
            f"near (1/k)^8, as bending theory predicts: {1 / 2**8:.4f}, {1 / 3**8:.3g}, {1 / 4**8:.3g}, {1 / 5**8:.3g}",
        ),
    )


def _meanings(found: Components) -> tuple[Row, Row]:
    first, second = found.transformed[:, 0], found.transformed[:, 1]
    size = np.corrcoef(first, np.linalg.norm(found.transformed, axis=1))[0, 1]
    odd = float(np.abs(second + second[::-1]).max() / np.abs(second).max())
    pairs = found.transformed[:, :2]
    apart = np.linalg.norm(pairs[:, None] - pairs[None, :], axis=2)[~np.eye(len(pairs), dtype=bool)].min()
    return (
        compared(
            "fig. 3: meaning of the first two components",
            "the magnitude of the deflection; its bias to the left or right",
            f"correlation with the length of the deflection vector {size:.6f}; odd about the middle to {odd:.1g}",
            agrees=bool(size > 0.999 and odd < 1e-6),
            why="they do not have the symmetry of the beam",
        ),
        compared(
            "sec. 3: each load has its own pair of the first two components",
            "unique",
            f"two loads 1 mm apart differ by at least {apart:.2g} W l³/(EI), {apart / MAX_DEFLECTION * 100:.1f} % of "
            "the largest deflection",
            agrees=bool(apart > 0),
            why="two loads have the same pair",
        ),
    )


def figure_7(optimised_mm: Floats) -> Figure:
    """Return figure 7: the components of four sensors at equal pitch and of four optimised sensors."""
    equal = principal_components(dimensionless(equal_pitch_mm(4))).transformed
    best = principal_components(dimensionless(optimised_mm)).transformed
    best = best * np.sign((best * equal).sum(axis=0))  # the sign of a component is arbitrary
    eight = principal_components(dimensionless(equal_pitch_mm(8))).transformed
    peaks = np.abs(best).max(axis=0) / np.abs(equal).max(axis=0)
    from_eight = np.abs(best).max(axis=0) / np.abs(eight).max(axis=0)[:4]
    series = []
    for k in range(4):
        # Divide each by its own peak at equal pitch: on one scale the third and fourth would be flat lines.
        scale = np.abs(equal[:, k]).max()
        series += [
            Series(f"component {k + 1}, equal pitch", LOADS_MM.tolist(), rounded(equal[:, k] / scale), k, "dashed"),
            Series(f"component {k + 1}, optimised", LOADS_MM.tolist(), rounded(best[:, k] / scale), k),
        ]
    says = "The components of four sensors, at equal pitch and optimised, each relative to its peak at equal pitch"
    results = {
        "positions_mm": {"equal": rounded(equal_pitch_mm(4)), "optimised": rounded(optimised_mm)},
        "peak_optimised_over_equal": rounded(peaks),
        "peak_optimised_over_eight_equal": rounded(from_eight),
    }
    chart = Chart(says, "position of the load, mm", "relative to the peak at equal pitch", series)
    return Figure(7, "components-optimised", f"{says}.", chart, results, _peak_rows(peaks, from_eight))


def _peak_rows(peaks: Floats, from_eight: Floats) -> tuple[Row, ...]:
    change, other = (peaks - 1) * 100, (from_eight - 1) * 100
    against_eight = (
        f"relative to eight equal sensors it changes by {other[0]:.0f} %, but so does the fourth, by {other[3]:.0f} %"
    )
    stated = (
        ("first component, optimised over equal", "prominent reduction", change[0] < -10,
         f"it falls only a little; {against_eight}"),
        ("second", "slight reduction", -10 < change[1] < 0, "it does not fall slightly"),
        ("third", "slight decrease, more near the middle", -10 < change[2] < 0,
         "it grows slightly; beside four or eight equal sensors, the third never falls while the fourth grows"),
        ("fourth", "increase", change[3] > 0, "it does not grow"),
    )  # fmt: skip
    return tuple(
        compared(f"fig. 7: peak of the {name}", paper, f"{ours:+.1f} %", agrees=bool(agrees), why=why)
        for (name, paper, agrees, why), ours in zip(stated, change, strict=True)
    )


NOISES_PERCENT = (2.0, 10.0)
NOISE_DRAWS = 50
OPTIMUM = 4
"""The paper: "a use of four sensors was identified as an optimum number"."""


def noise_errors(noise_percent: float, seed: int) -> tuple[Floats, float, float]:
    """Return the mean |error| of each component under noise, in percent of its mean size, and the fit y = A x^B.

    Returns
    -------
    (8,) percent, A in percent, and B; the fit is a straight line through the logarithms.
    """
    matrix = dimensionless(equal_pitch_mm(8))
    found = principal_components(matrix)
    rng = np.random.default_rng([seed, round(noise_percent * 1000)])
    noise = rng.normal(size=(NOISE_DRAWS, *matrix.shape)) * noise_percent / 100
    error = np.abs(noise * MAX_DEFLECTION @ found.vectors).mean(axis=(0, 1))
    percent: Floats = error / np.abs(found.transformed).mean(axis=0) * 100
    exponent, factor = np.polyfit(np.log(np.arange(1, 9)), np.log(percent), 1)
    return percent, float(np.exp(factor)), float(exponent)


def figure_4(seed: int) -> Figure:
    """Return figure 4: the error of each component under 2 % and 10 % noise."""
    number = np.arange(1, 9)
    found = {noise: noise_errors(noise, seed) for noise in NOISES_PERCENT}
    series = []
    for colour, noise in enumerate(NOISES_PERCENT):
        percent, factor, exponent = found[noise]
        label = f"{noise:g} % noise: y = {factor:.2f} x^{exponent:.2f}"
        series += [
            Series("", number.tolist(), rounded(percent), colour, "points"),
            Series(label, number.tolist(), rounded(factor * number**exponent), colour),
        ]
    says = "Mean error of the components under 2 % and 10 % noise, in percent of their size, with the fit y = A x^B"
    results = {
        f"noise_{noise:g}_percent": {
            "error_percent": rounded(found[noise][0]),
            "A": found[noise][1],
            "B": found[noise][2],
        }
        for noise in NOISES_PERCENT
    }
    chart = Chart(says, "component", "mean |error|, % of the component's size", series, log_x=True, log_y=True)
    return Figure(4, "noise", f"{says}.", chart, results, _noise_rows(*found.values()))


def _noise_rows(at_2: tuple[Floats, float, float], at_10: tuple[Floats, float, float]) -> tuple[Row, ...]:
    (low, low_factor, low_exponent), (high, high_factor, high_exponent) = at_2, at_10
    return (
        compared(
            "fig. 4: error of the components, 2 % against 10 % noise",
            "increases with the noise",
            f"{(high / low).min():.2f} to {(high / low).max():.2f} times as large",
            agrees=bool((high > low).all()),
            why="it does not increase for every component",
        ),
        compared(
            "fig. 4: error by number of the component",
            "increases, as y = A x^B",
            f"increases from the first ({low[0]:.2g} % at 2 % noise) to the eighth ({low[7]:.2g} %)",
            agrees=bool((np.diff(low) > 0).all() and (np.diff(high) > 0).all()),
            why="it does not increase from each component to the next",
        ),
        Row(
            "fig. 4: fitted A and B",
            "",
            f"2 %: A = {low_factor:.2f} %, B = {low_exponent:.2f}; 10 %: A = {high_factor:.2f} %, "
            f"B = {high_exponent:.2f}",
            "not stated",
            "B is near 4, because the size of a component falls as (1/k)^4 and its noise does not",
        ),
        _optimum_row(low, high),
    )


def _optimum_row(at_2: Floats, at_10: Floats) -> Row:
    """Return the row of the paper's optimum number of sensors; errors of the components in percent of their size."""
    low, high = (int((errors < 100).sum()) for errors in (at_2, at_10))
    largest = NOISES_PERCENT[0] * 100 / at_2[OPTIMUM - 1]
    return compared(
        "sec. 4, 6: optimum number of sensors, from the components under noise",
        "four",
        f"of eight components, {low} are larger than their error at 2 % noise, {high} at 10 %, and {OPTIMUM} up to "
        f"{largest:.2f} %",
        agrees=low == OPTIMUM,
        why="the paper does not say how large a component must be beside its noise",
    )
