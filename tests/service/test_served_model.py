"""The model asked in memory of its own answers as when asked plainly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beamtouch_models import modelfile
from beamtouch_service.surfaces.served_model import Inference
from settled import settled_whitening

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel


def as_lists(answers: modelfile.Answers) -> dict[str, list[float]]:
    return {name: values.tolist() for name, values in answers.items()}


def test_one_sample_after_the_other_is_answered_as_if_alone(bench_model: Path) -> None:
    model = modelfile.load(bench_model)
    inference = Inference(model)
    random = np.random.default_rng(1)
    for number in range(50):
        shape = (1 + number % 3, len(model.channels))
        deflection_mm = random.uniform(-0.1, 1, shape).astype(np.float32)
        weights = settled_whitening(model, deflection_mm, random.random(shape) < 0.8)
        assert as_lists(inference.ask(deflection_mm, weights)) == as_lists(model.estimate(deflection_mm, weights))


def test_two_models_do_not_share_memory(build_model: BuildModel) -> None:
    one = Inference(modelfile.load(build_model()))
    other = Inference(modelfile.load(build_model()))
    values, weights = np.array([[0.5, 0.25, 0.125]], np.float32), np.eye(3, dtype=np.float32)[None]
    found = one.ask(values, weights)
    other.ask(np.zeros((1, 3), np.float32), weights)

    assert found["position_mm"].tolist() == [150.0]
    assert as_lists(one.ask(values, weights)) == as_lists(found)
