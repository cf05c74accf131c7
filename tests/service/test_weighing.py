"""Samples weighed by their covariance: in the model's order, by the sender's noise, and whatever is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.physics.beam import scene_influence
from beamtouch_models.scene import load_scene
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.estimate import Estimator
from beamtouch_service.surfaces.surface import Surface
from example_scenes import SCENES

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel

NOISE_MM = 0.01
"""Of a reading and of a settled sample of the small model."""


def batch(*samples: dict[str, Any], channels: tuple[str, ...] = ("s1", "s2", "s3"), **more: object) -> Batch:
    made = [
        {"sequence": number, "acquired_unix_us": number, "quality": ["good"] * len(channels)} | sample
        for number, sample in enumerate(samples, start=1)
    ]
    return Batch.model_validate(
        {"boot_id": "boot-0001", "channels": list(channels), "newest_age_ms": 0.0, "samples": made} | more
    )


def weigh(model: modelfile.ModelFile, given: Batch) -> modelfile.Weighed:
    """Return the samples of a batch as the model weighs them."""
    return Estimator(model, "press-7").estimate(given, given.samples)[0].together


@pytest.fixture
def model(build_model: BuildModel) -> modelfile.ModelFile:
    return modelfile.load(build_model())


def test_a_sample_without_readings_is_a_settled_one(model: modelfile.ModelFile) -> None:
    given = batch({"deflection_mm": [0.1, 0.2, 0.3]})
    weighed = weigh(model, given)
    assert weighed.deflection_mm.tolist() == [[0.1, 0.2, 0.3]]
    assert weighed.covariance_mm2[0] == pytest.approx(np.eye(3) * NOISE_MM**2)
    assert (weighed.noise_mm2[0] == NOISE_MM**2).all()


def test_readings_divide_the_noise_that_the_sender_states(model: modelfile.ModelFile) -> None:
    given = batch({"deflection_mm": [0.1, 0.2, 0.3], "readings": 4}, noise_mm=[0.011, 0.012, 0.009])
    weighed = weigh(model, given)
    assert np.diag(weighed.covariance_mm2[0]) == pytest.approx(np.square([0.011, 0.012, 0.009]) / 4)


def test_a_covariance_is_taken_in_the_order_of_the_model(model: modelfile.ModelFile) -> None:
    triangle = [3.0, 0.1, 4.0, 0.2, 0.3, 5.0, 0.4, 0.5, 0.6, 6.0]
    sample = {"deflection_mm": [0.3, 9.0, 0.1, 0.2], "readings": 4, "covariance_mm2": triangle}
    given = batch(sample, channels=("s3", "other", "s1", "s2"), noise_mm=[NOISE_MM] * 4)
    weighed = weigh(model, given)
    assert weighed.deflection_mm.tolist() == [[0.1, 0.2, 0.3]]
    assert weighed.covariance_mm2[0].tolist() == [[5.0, 0.6, 0.2], [0.6, 6.0, 0.4], [0.2, 0.4, 3.0]]
    assert weighed.noise_mm2[0] == pytest.approx(np.full(3, NOISE_MM**2 / 4))


@pytest.mark.parametrize(("stated", "counts"), [(0.005, 0.01), (0.02, 0.02), (0.0085, 0.0085), (0.012, 0.012)])
def test_of_two_contradicting_noises_the_larger_counts(
    model: modelfile.ModelFile, stated: float, counts: float
) -> None:
    triangle = [stated**2 / 4 + 1e-6, 0.0, stated**2 / 4, 0.0, 0.0, stated**2 / 4]
    plain = {"deflection_mm": [0.1, 0.2, 0.3], "readings": 4}
    given = batch(plain, plain | {"covariance_mm2": triangle}, noise_mm=[stated] * 3)
    weighed = weigh(model, given)
    white = counts**2 / 4
    assert np.diag(weighed.covariance_mm2[0]) == pytest.approx([white] * 3)
    assert np.diag(weighed.covariance_mm2[1]) == pytest.approx([white + 1e-6, white, white])


@pytest.mark.parametrize(("stated", "notes"), [(0.005, ["noise"]), (0.01, []), (0.012, []), (0.02, ["noise"])])
def test_a_surface_says_that_the_noise_contradicts_its_model(
    model: modelfile.ModelFile, stated: float, notes: list[str]
) -> None:
    surface = Surface("press-7", model)
    rest = {"deflection_mm": [0.0, 0.0, 0.0], "readings": 1}
    # Of more noise than the model was made for, three samples show rest.
    surface.receive(batch(rest, rest, rest, noise_mm=[stated] * 3), 10.0)
    assert surface.contact(10.0).notes == notes


def test_a_missing_channel_takes_no_part_whatever_its_covariance(bench_model: Path) -> None:
    model = modelfile.load(bench_model)
    channels = tuple(model.channels)
    load = [0.01 * (number + 1) for number in range(len(channels))]
    answers = []
    for third in (None, 5.0):
        sample = {
            "deflection_mm": [third if number == 2 else value for number, value in enumerate(load)],
            "quality": ["saturated" if number == 2 else "good" for number in range(len(channels))],
        }
        surface = Surface("bench", model)
        surface.receive(batch(sample, channels=channels), 10.0)
        answers.append(surface.contact(10.0))
    assert answers[0] == answers[1]
    assert answers[0].degraded_channels == [channels[2]]


def test_a_larger_covariance_widens_the_interval_and_is_unsteady(bench_model: Path) -> None:
    model = modelfile.load(bench_model)
    noise_mm, channels = model.metadata.noise.reading_mm, tuple(model.channels)
    scene, at_mm = load_scene(SCENES / "bench.toml")[0], [channel.position_mm for channel in model.metadata.layout]
    shape = scene_influence(scene, at_mm, [model.metadata.length_mm / 2])[0]
    load = (25 * noise_mm * shape / shape.max()).tolist()
    size = len(channels)
    triangle = [float((100 * noise_mm) ** 2 / 16 * (i == j)) for i in range(size) for j in range(i + 1)]
    widths, notes = [], []
    for more in ({}, {"covariance_mm2": triangle}):
        surface = Surface("bench", model)
        settled = {"deflection_mm": load, "readings": 20}
        surface.receive(batch(settled, settled | more, channels=channels, noise_mm=[noise_mm] * size), 10.0)
        contact = surface.contact(10.0)
        assert contact.state is modelfile.State.CONTACT
        assert contact.position_high_mm is not None
        assert contact.position_low_mm is not None
        widths.append(contact.position_high_mm - contact.position_low_mm)
        notes.append(contact.notes)
    assert widths[1] > 5 * widths[0]
    assert notes[1] == [*notes[0], "unsteady"]
