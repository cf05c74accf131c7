"""Errors since a touch for plain means of readings, of a model that answers in proportion to one channel."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.since_touch import Touches, answers_of_means
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.surface import Surface, resolve
from beamtouch_models.design.world import World
from beamtouch_models.places import Extent, positions_of
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.metadata_parts import FilterChoice
from beamtouch_models.runtime.session import Answers
from support.surfaces.example_scenes import SCENES

PER_MM = 1e4
"""Millimetres of the place for each of the second channel's, which shows nothing under a contact at 100 mm."""


def shown(place_mm: Floats) -> Floats:
    x = place_mm[..., 0]
    return np.stack([np.full(x.shape, 0.01), (x - 100) / PER_MM, np.zeros(x.shape)], axis=-1)


class Plain(World):
    """A world whose sensors show just that under 1 N, with readings that have a noise of 2 um."""

    def under(self, position_mm: Floats | float, force_n: Floats | float) -> Floats:
        """Return what the sensors show."""
        deflections: Floats = shown(np.asarray(position_mm)[..., None]) * np.asarray(force_n)[..., None]
        return deflections

    @property
    def reading_mm(self) -> float:
        """The noise of a reading."""
        return 0.002


def run(deflection_mm: NDArray[np.floating], _whitening: NDArray[np.floating]) -> Answers:
    return {"position_mm": 100 + PER_MM * deflection_mm[:, 1]}


@pytest.fixture(scope="module")
def surface() -> Surface:
    return resolve(load_scene(SCENES / "bench.toml")[0])


@pytest.fixture(scope="module")
def world(surface: Surface) -> Plain:
    real = World.of(surface.scene, surface.sensor, np.array([60.0, 200.0, 341.0]), 0.0)
    return Plain(**{field.name: getattr(real, field.name) for field in fields(World)})


def prior(errors: Errors) -> Prior:
    return Prior(Extent.of_beam((0.0, 400.0)), 400.0, (1.0, 1.0), errors, 3, shown)


def of_filter(surface: Surface, window: int, most: int) -> Surface:
    return replace(surface, filter=FilterChoice(kind="growing-mean", window=window, longest=most))


@pytest.mark.parametrize(
    ("window", "most", "counts"),
    [
        (4, 400, [2, 4, 16, 256]),
        (4, 100, [2, 4, 16, 100]),
        (3, 7, [2, 3, 7]),
        (1, 300, [1, 2, 4, 256]),
        (1, 1, [1]),
        (300, 500, [2, 300]),
    ],
)
def test_means_are_of_two_readings_the_window_four_windows_and_the_longest(
    surface: Surface, world: Plain, window: int, most: int, counts: list[int]
) -> None:
    """The error is in proportion to the noise of a mean, and that of the window as it was measured."""
    error_mm = Measurement(5.0, 0.25)
    found = answers_of_means(
        prior(Errors(0.001)), run, of_filter(surface, window, most), world, error_mm, 3, Effort(0.1)
    )
    assert [one.readings for one in found] == counts
    assert [one.since_ms for one in found] == [1e3 * count / 200 for count in counts]
    expected = [5.0 * math.sqrt(window / count) for count in counts]
    assert [one.error_mm.value for one in found] == pytest.approx(expected)
    assert [one.error_mm.standard_error for one in found] == pytest.approx([0.05 * value for value in expected])
    assert all(one.ringing_mm is None for one in found)


def test_a_touch_errs_by_its_noise_over_the_root_of_the_readings(world: Plain) -> None:
    touches = Touches.draw(prior(Errors(0.001)), world, 500, 3)
    assert len(touches.shown_mm) == 512
    noise = np.random.default_rng(1).normal(size=touches.shown_mm.shape)
    errors_mm = touches.plain_errors_mm(run, 9, noise)
    assert errors_mm == pytest.approx(np.abs(noise[:, 1]) * PER_MM * 0.002 / 3)
    # A channel without a reading counts as 0.
    sample_mm = touches.shown_mm.copy()
    sample_mm[:100, 1] = np.nan
    errors_mm = touches.errors_mm(run, sample_mm, np.eye(3) * 1e-6)
    assert errors_mm[:100] == pytest.approx(np.abs(touches.drawn.position_mm[:100] - 100))
    assert errors_mm[100:] == pytest.approx(0.0, abs=1e-6)


def test_sensors_have_the_gains_and_zeros_that_the_model_allows_for(world: Plain) -> None:
    touches = Touches.draw(prior(Errors(0.001, 0.02, 0.003)), world, 2000, 3)
    assert touches.errors.gain.std(axis=0) == pytest.approx(np.full(3, 0.02), rel=0.06)
    assert touches.errors.gain.mean(axis=0) == pytest.approx(np.ones(3), abs=0.002)
    assert touches.errors.zero_mm.std(axis=0) == pytest.approx(np.full(3, 0.003), rel=0.06)
    assert np.corrcoef(touches.errors.gain[:, 0], touches.errors.zero_mm[:, 0])[0, 1] == pytest.approx(0, abs=0.08)
    assert touches.shown_mm == pytest.approx(shown(touches.drawn.place_mm))
    assert positions_of(touches.drawn.place_mm).min() < 10
