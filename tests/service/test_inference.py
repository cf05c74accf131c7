"""The model asked in memory of its own answers as when asked plainly."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from beamtouch_models import modelfile
from beamtouch_service.inference import Durations, Inference

if TYPE_CHECKING:
    from pathlib import Path

    from service.conftest import BuildModel


def asked_plainly(model: modelfile.ModelFile, deflection_mm: list[float], valid: list[bool]) -> dict[str, float]:
    answers = model.estimate(np.array([deflection_mm], np.float32), np.array([valid], np.bool_))
    return {name: float(values[0]) for name, values in answers.items()}


def test_one_sample_after_the_other_is_answered_as_if_alone(bench_model: Path) -> None:
    model, durations = modelfile.load(bench_model), Durations()
    inference = Inference(model, durations)
    random = np.random.default_rng(1)
    for _ in range(50):
        deflection_mm = list(random.uniform(-0.1, 1, len(model.channels)))
        valid = [bool(one) for one in random.random(len(model.channels)) < 0.8]
        assert inference.estimate(deflection_mm, valid) == asked_plainly(model, deflection_mm, valid)
    assert sum(durations.counts) == 50
    assert durations.sum_s > 0


def test_two_models_do_not_share_memory(build_model: BuildModel) -> None:
    one = Inference(modelfile.load(build_model()), Durations())
    other = Inference(modelfile.load(build_model()), Durations())
    found = one.estimate([0.5, 0.25, 0.125], [True] * 3)
    other.estimate([0.0, 0.0, 0.0], [True] * 3)

    assert found["position_mm"] == 150.0
    assert one.estimate([0.5, 0.25, 0.125], [True] * 3) == found
