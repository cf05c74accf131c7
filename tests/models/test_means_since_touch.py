"""Errors by the number of loaded readings, of an answer that errs as the noise of its sample, or always by the same."""

import numpy as np
import pytest
from numpy.typing import NDArray

from beamtouch_models import change_scene, read_scene, resolve
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.since_touch import Answer, answers_of_means, answers_since_touch
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.layout import Layout
from support.surfaces.example_scenes import SCENES

FAR_MM = 1e10
FEW = Effort(0.01)


@pytest.fixture(scope="module")
def layout() -> Layout:
    """Sensors without errors of gains and zeros, whose filter takes 4 readings of 200 a second."""
    exact = {"gain_error_percent": 0.0, "zero_drift_mm": 0.0}
    return resolve(change_scene(read_scene(SCENES / "bench.toml"), sensors=exact)).layout([68, 156, 244, 332])


def by_noise(_sample: NDArray[np.floating], weights: NDArray[np.floating]) -> dict[str, NDArray[np.float32]]:
    """Far away, by the deviation of the first channel over that of a reading."""
    return {"position_mm": (FAR_MM / weights[:, 0, 0]).astype(np.float32)}


def always(sample: NDArray[np.floating], _weights: NDArray[np.floating]) -> dict[str, NDArray[np.float32]]:
    return {"position_mm": np.full(len(sample), FAR_MM, np.float32)}


def test_means_are_of_two_readings_of_those_of_the_filter_of_four_times_as_many_and_of_the_longest(
    layout: Layout,
) -> None:
    """An error that is the noise of the sample falls with the root of the readings."""
    surface = layout.surface
    assert (surface.filter.window, surface.filter.max_readings) == (4, 200)
    answers = answers_of_means(layout.prior, by_noise, surface, layout.world, Measurement(3.0, 0.06), 5, FEW)
    assert [(answer.readings, answer.since_ms) for answer in answers] == [(2, 10), (4, 20), (16, 80), (200, 1000)]
    for answer in answers:
        assert answer.error_mm.value == pytest.approx(3.0 * (4 / answer.readings) ** 0.5, rel=1e-3)
        assert answer.error_mm.standard_error == pytest.approx(0.06 * (4 / answer.readings) ** 0.5, rel=1e-3)
        assert answer.ringing_mm is None


def test_behind_the_filter_an_answer_that_is_always_the_same_errs_as_much_whatever_the_beam_does(
    layout: Layout,
) -> None:
    plain = [Answer(2, 10.0, Measurement(3.0, 0.06)), Answer(4, 20.0, Measurement(2.0, 0.04))]
    behind = answers_since_touch(plain, layout.prior, always, layout.surface, layout.world, 5, FEW)
    assert [(one.readings, one.since_ms) for one in behind] == [(2, 10.0), (4, 20.0)]
    for one, of_mean in zip(behind, plain, strict=True):
        assert one.error_mm.value == pytest.approx(of_mean.error_mm.value)
        assert one.error_mm.standard_error == pytest.approx(of_mean.error_mm.standard_error)
        assert one.ringing_mm is not None
        assert one.ringing_mm.value == pytest.approx(of_mean.error_mm.value)
