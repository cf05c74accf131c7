"""The accuracy limit, against published limits and plain integrals."""

import mpmath
import numpy as np
import pytest

from beamtouch_models.accuracy import limit, posterior
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.physics.beam import influence, influence_of
from beamtouch_models.scene import Scene
from beamtouch_models.surface import Surface
from example_scenes import paper_scene
from plain_error import mean_error


def limit_of(scene: Scene, *sensors: float, draws: int = 6000) -> limit.MeanError:
    prior = Prior.of(influence_of(scene), np.array(sensors), Surface.of(scene).readings.reading_mm)
    drawn = limit.draw(prior, draws, 1)
    return mean_error(prior, drawn, limit.posterior_median_mm(prior, drawn.deflection_mm))


@pytest.mark.parametrize(("layout", "percent"), [((400 / 3, 800 / 3), 4.50), ((122, 278), 4.12), ((107, 293), 3.78)])
def test_the_limits_that_are_known_for_the_paper(layout: tuple[float, float], percent: float) -> None:
    found = limit_of(paper_scene(), *layout)
    assert abs(found.percent - percent) < 3.5 * found.standard_error + 0.005


def test_the_posterior_median_equals_a_plain_integral_over_position_and_force() -> None:
    base = paper_scene().model_dump()
    scene = Scene.model_validate({**base, "contact": {"force_n": (2.0, 20.0), "position_mm": (1, 399)}})
    layout, noise = np.array([100.0, 200.0, 300.0]), 0.02
    prior = Prior.of(influence_of(scene), layout, noise)
    drawn = limit.draw(prior, 5, 3)
    found = limit.posterior_median_mm(prior, drawn.deflection_mm)
    grid, forces = np.linspace(1, 399, 1991), np.linspace(2, 20, 3001)
    shapes = influence(scene.beam, layout, grid)
    for reading, median in zip(drawn.deflection_mm, found, strict=True):
        square = sum((value - np.outer(shape, forces)) ** 2 for value, shape in zip(reading, shapes.T, strict=True))
        density = np.exp(-(square - np.min(square)) / (2 * noise**2)).sum(axis=1)
        cumulative = np.cumsum(density) / density.sum()
        assert median == pytest.approx(np.interp(0.5, cumulative, grid), abs=0.15)


@pytest.mark.parametrize(
    ("low", "high"), [(-1.0, 1.0), (5.0, 6.0), (30.0, 31.0), (-31.0, -30.0), (8.0, 1e3), (0.0, 1e-9), (37.0, 37.5)]
)
def test_normal_intervals_in_both_tails(low: float, high: float) -> None:
    with mpmath.workdps(400):
        # In the far tails ncdf itself cancels; erfc does not.
        root = mpmath.sqrt(2)
        exact = (mpmath.erfc(low / root) - mpmath.erfc(high / root)) / 2
        expected = float(mpmath.log(exact))
    found = posterior._log_normal_interval(np.array([low]), np.array([high]))[0]
    assert found == pytest.approx(expected, rel=1e-7)
