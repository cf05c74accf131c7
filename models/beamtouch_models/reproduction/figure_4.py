"""Figure 4: the errors of the principal components under noise."""

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.charts import Chart, Series
from beamtouch_models.placement.components import principal_components
from beamtouch_models.reproduction.finding import Figure, Row, compared, rounded
from beamtouch_models.reproduction.paper import MAX_DEFLECTION, dimensionless, equal_pitch_mm

NOISES_PERCENT = (2.0, 10.0)
NOISE_DRAWS = 50


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
    )
