"""Figures 2 to 7, and the misprints: the sensor's characteristic, the principal components, and the paper's search."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.charts import Chart, Series
from beamtouch_models.design.placement.eigenvalue_product import eigenvalue_product_of, principal_components
from beamtouch_models.design.placement.search import SearchRun, paper_search
from beamtouch_models.design.surface import resolve
from beamtouch_models.design.world import counts_of_output, output_of_gap
from beamtouch_models.lab.reproduction.paper import (
    LENGTH_MM,
    LOADS_MM,
    MAX_DEFLECTION,
    SCENE,
    Figure,
    Row,
    deflection_mm,
    dimensionless,
    equal_pitch_mm,
    rounded,
    rows_of,
)
from beamtouch_models.places import positions_of


def figure_2() -> Figure:
    """Return figure 2: the output of the rig's sensor over the gap, and its deviation from a line from 1 to 4 mm."""
    sensor = resolve(SCENE).sensor
    gap = np.linspace(0.0, 5.0, 501)
    output = counts_of_output(sensor, output_of_gap(sensor, gap)) / (2**sensor.adc_bits - 1) * 100
    is_stated, ends = (gap >= 1) & (gap <= 4), np.array([0.5, 4.5])
    line = np.polynomial.Polynomial.fit(gap[is_stated], output[is_stated], 1)
    departure = np.abs(output - line(gap))
    straight_mm = gap[departure < 0.01][[0, -1]]
    series = [
        Series("output of the rig's sensor", rounded(gap), rounded(output)),
        Series("straight from 1 to 4 mm, as the paper states", rounded(ends), rounded(line(ends)), 1, "dashed"),
    ]
    says = "Output of the proximity sensor over its gap: straight from 1 to 4 mm, levelling off beyond"
    numbers = {"straight_mm": straight_mm, "departure_percent": float(departure[is_stated].max())}
    checks = {"linear": np.allclose(straight_mm, (1, 4), atol=0.1)}
    return Figure(2, "sensor", Chart(says, "gap, mm", "output, % of the scale", series), rounded(numbers), checks)


DISCERNIBLE = 0.005
"""A curve within less than this share of a plot's height looks like a flat line: half a millimetre of 100 mm."""


def figure_3() -> Figure:
    """Return figure 3: the components of eight equally pitched sensors."""
    components = principal_components(dimensionless(equal_pitch_mm(8)))
    transformed, spans = components.transformed, np.ptp(components.transformed, axis=0)
    pairs = transformed[:, :2]
    first, second = pairs.T
    apart = np.linalg.norm(pairs[:, None] - pairs[None, :], axis=2)[~np.eye(len(pairs), dtype=bool)].min()
    size_correlation = float(np.corrcoef(first, np.linalg.norm(transformed, axis=1))[0, 1])
    even_part = float(np.abs(second + second[::-1]).max() / np.abs(second).max())
    discernible = int((spans / spans[0] >= DISCERNIBLE).sum())
    numbers = {
        "eigenvalues": components.eigenvalues,
        "eigenvalues_over_first": components.eigenvalues / components.eigenvalues[0],
        "spans_over_first": spans / spans[0],
        "discernible": discernible,
        "size_correlation": size_correlation,
        "even_part": even_part,
        "apart": float(apart),
        "apart_percent": float(apart / MAX_DEFLECTION * 100),
    }
    checks = {
        "visible": discernible == 4,
        "symmetric": size_correlation > 0.999 and even_part < 1e-6,
        "unique": bool(apart > 0),
    }
    curves = [Series(f"component {k + 1}", LOADS_MM.tolist(), rounded(transformed[:, k]), k) for k in range(4)]
    says = "The four largest components of eight equally pitched sensors over the position of the load"
    chart = Chart(says, "position of the load, mm", "size, W l³/(EI)", curves)
    return Figure(3, "components", chart, rounded(numbers), checks)


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
    components = principal_components(matrix)
    rng = np.random.default_rng([seed, round(noise_percent * 1000)])
    noise = rng.normal(size=(NOISE_DRAWS, *matrix.shape)) * noise_percent / 100
    error = np.abs(noise * MAX_DEFLECTION @ components.vectors).mean(axis=(0, 1))
    percent: Floats = error / np.abs(components.transformed).mean(axis=0) * 100
    exponent, factor = np.polyfit(np.log(np.arange(1, 9)), np.log(percent), 1)
    return percent, float(np.exp(factor)), float(exponent)


def figure_4(seed: int) -> Figure:
    """Return figure 4: the error of each component under 2 % and 10 % noise."""
    component = np.arange(1, 9)
    errors, factors, exponents = zip(*(noise_errors(noise, seed) for noise in NOISES_PERCENT), strict=True)
    series = []
    for colour, noise in enumerate(NOISES_PERCENT):
        label = f"{noise:g} % noise: y = {factors[colour]:.2f} x^{exponents[colour]:.2f}"
        fitted = factors[colour] * component ** exponents[colour]
        series += [
            Series("", component.tolist(), rounded(errors[colour]), colour, "points"),
            Series(label, component.tolist(), rounded(fitted), colour),
        ]
    times = errors[1] / errors[0]
    larger = [int((percent < 100).sum()) for percent in errors]
    numbers = {
        "error_percent": errors,
        "A": factors,
        "B": exponents,
        "times": [times.min(), times.max()],
        "larger": larger,
        "four_up_to_percent": float(NOISES_PERCENT[0] * 100 / errors[0][OPTIMUM - 1]),
    }
    checks = {
        "noise": bool((errors[1] > errors[0]).all()),
        "component": bool((np.diff(errors) > 0).all()),
        "four": larger[0] == OPTIMUM,
    }
    says = "Mean error of the components under 2 % and 10 % noise, in percent of their size, with the fit y = A x^B"
    chart = Chart(says, "component", "mean |error|, % of the component's size", series, log_x=True, log_y=True)
    return Figure(4, "noise", chart, rounded(numbers), checks)


SENSORS, LEADING = 8, 4
OTHER_SEEDS = 20
EXPECTED_MM = (68, 69, 156, 157, 243, 244, 331, 332)
"""Read off the paper's figure 5."""
EXPECTED_ITERATIONS = 20
"""The paper: "within approximately 20 iterations"."""


def figures_5_and_6(seed: int) -> tuple[Figure, Figure]:
    """Return figures 5 and 6: positions and performance value m over the iterations.

    This is the search of section 4, for eight sensors by their four leading eigenvalues, from equal pitch.
    """
    surface = resolve(SCENE)
    product = eigenvalue_product_of(surface.influence, surface.rules, SENSORS, LEADING)
    start = SearchRun((product.equal,), (product.scores(product.equal[None]).item(),), 1)
    seeds = range(seed, seed + OTHER_SEEDS + 1)
    runs = [paper_search(product, start, np.random.default_rng(run_seed)) for run_seed in seeds]
    iterations = [int(np.flatnonzero(np.diff(run.scores))[-1]) + 1 for run in runs]
    return _positions(positions_of(surface.rules.place_mm)[np.array(runs[0].layouts)], iterations), _performance(
        runs[0]
    )


def _positions(positions_mm: Floats, iterations: list[int]) -> Figure:
    """Return figure 5. `iterations` up to the last gain are those of this search and of others."""
    final, steps = positions_mm[-1], list(range(len(positions_mm)))
    off_mm = float(np.abs(final - EXPECTED_MM).max())
    pair_mm = float(np.ptp(final.reshape(4, 2), axis=1).max())
    asymmetry_mm = float(np.abs(final + final[::-1] - LENGTH_MM).max())
    numbers = {
        "positions_mm": positions_mm,
        "places": ", ".join(f"{place:g}" for place in final),
        "off_mm": off_mm,
        "groups": int((np.diff(final) > 10).sum()) + 1,
        "pair_mm": pair_mm,
        "asymmetry_mm": asymmetry_mm,
        "iterations": iterations,
        "fewest": min(iterations),
        "most": max(iterations),
        "searches": len(iterations),
    }
    checks = {
        "places": off_mm <= 1,
        "pairs": pair_mm <= 1,
        "symmetric": asymmetry_mm <= 2,
        "iterations": abs(iterations[0] - EXPECTED_ITERATIONS) <= 5,
    }
    tracks = [Series("", positions_mm[:, k].tolist(), steps, k) for k in range(SENSORS)]
    tracks += [Series("read off the paper's figure 5", EXPECTED_MM, [steps[-1]] * SENSORS, 0, "ring")]
    says = "Positions of eight sensors over the iterations of the search: pairs merge, which leaves four places"
    chart = Chart(says, "position of the sensor, mm", "iteration", tracks, x_range=(0.0, LENGTH_MM))
    return Figure(5, "positions", chart, rounded(numbers), checks)


def _performance(run: SearchRun) -> Figure:
    """Return figure 6."""
    # m itself (eq. 4) depends on the unit of deflection; relative to its last value it does not.
    performance, iterations = np.exp(run.scores[-1] - np.array(run.scores)), len(run.scores) - 1
    half = int(np.argmax(performance < (1 + performance[0]) / 2))
    numbers = {
        "first_over_last": float(performance[0]),
        "half": half,
        "log_eigenvalue_product": [run.scores[0], run.scores[-1]],
    }
    checks = {"falls": bool((np.diff(performance) <= 0).all()) and half <= iterations / 3}
    convergence = [EXPECTED_ITERATIONS] * 2, [1.0, float(performance[0])]
    series = [
        Series("m", list(range(iterations + 1)), rounded(performance)),
        Series("the paper: converged after about 20 iterations", *convergence, 1, "dashed"),
    ]
    says = "The performance value m over the iterations of the search, relative to its last value"
    chart = Chart(says, "iteration", "m over its last value", series, whole_x=True)
    return Figure(6, "performance", chart, rounded(numbers), checks)


def figure_7(optimised_mm: Floats) -> Figure:
    """Return figure 7: the components of four sensors at equal pitch and of four optimised sensors."""
    equal, best, eight = (
        principal_components(dimensionless(places_mm)).transformed[:, :4]
        for places_mm in (equal_pitch_mm(4), optimised_mm, equal_pitch_mm(8))
    )
    best = best * np.sign((best * equal).sum(axis=0))  # the sign of a component is arbitrary
    equal_peak, best_peak, eight_peak = (np.abs(components).max(axis=0) for components in (equal, best, eight))
    change = (best_peak / equal_peak - 1) * 100
    numbers = {
        "positions_mm": {"equal": equal_pitch_mm(4), "optimised": optimised_mm},
        "change_percent": change,
        "from_eight_percent": (best_peak / eight_peak - 1) * 100,
    }
    checks = {
        "first": bool(change[0] < -10),
        "second": bool(-10 < change[1] < 0),
        "third": bool(-10 < change[2] < 0),
        "fourth": bool(change[3] > 0),
    }
    series = []
    for k in range(4):
        # Divide each by its own peak at equal pitch: on one scale the third and fourth would be flat lines.
        pitched, chosen = (rounded(components[:, k] / equal_peak[k]) for components in (equal, best))
        series += [
            Series(f"component {k + 1}, equal pitch", LOADS_MM.tolist(), pitched, k, "dashed"),
            Series(f"component {k + 1}, optimised", LOADS_MM.tolist(), chosen, k),
        ]
    says = "The components of four sensors, at equal pitch and optimised, each relative to its peak at equal pitch"
    chart = Chart(says, "position of the load, mm", "relative to the peak at equal pitch", series)
    return Figure(7, "components-optimised", chart, rounded(numbers), checks)


PRINTED_PITCH_MM = (67, 80, 100, 133)
MAX_SENSORS = 40
"""Bounds the search for the number of sensors at which equation 4 overflows."""


def misprints() -> list[Row]:
    """Return the rows of misprints: equations 1 and 4, and the pitches of section 5."""
    pitch_mm = [LENGTH_MM / (count + 1) for count in range(2, 6)]
    true = dimensionless(LOADS_MM)
    x, a = LOADS_MM[None, :] / LENGTH_MM, LOADS_MM[:, None] / LENGTH_MM
    literal, bracket = (
        float(np.abs(-equation_1(x, a, macaulay=macaulay) - true).max() / true.max()) for macaulay in (False, True)
    )
    overflow = next(count for count in range(2, MAX_SENSORS) if not np.isfinite(_performance_si(count)))
    checks = {
        "equation 1": literal < 1e-6,
        "equation 4": False,
        "pitches": np.allclose(pitch_mm, PRINTED_PITCH_MM, atol=0.5),
    }
    numbers = {"literal": literal, "bracket": bracket, "overflow": overflow, "pitch_mm": pitch_mm}
    return rows_of("misprints", numbers, checks)


def equation_1(x: Floats, a: Floats, *, macaulay: bool) -> Floats:
    """Return equation 1 in units of W l^3/(EI), with x and a over the length; upward is positive."""
    beyond = np.maximum(x - a, 0.0) if macaulay else x - a
    deflection: Floats = ((2 - a) * (a - 1) * a * x + (1 - a) * x**3 - beyond**3) / 6
    return deflection


def _performance_si(count: int) -> float:
    """Return equation 4 as printed, with lengths in metres."""
    eigenvalues = principal_components(deflection_mm(equal_pitch_mm(count)) / 1e3).eigenvalues
    with np.errstate(over="ignore", divide="ignore"):
        return float(1 / np.prod(eigenvalues))
