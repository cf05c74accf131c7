"""The Python interface and the service give the same answer, to the digit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

import beamtouch_models as models
from service.conftest import batch_of

if TYPE_CHECKING:
    from pathlib import Path

    from service.process.conftest import StartService

PLACES_MM = [60, 150, 300]
FIGURES = [
    "position_mm", "position_low_mm", "position_high_mm", "force_n", "force_low_n", "force_high_n",
]  # fmt: skip


def test_scripts_get_what_the_service_answers(bench_model: Path, start_service: StartService, token_file: Path) -> None:
    model = models.load_model(bench_model)
    scene = models.read_scene(model.metadata.scene + "\n")
    at_mm = [channel.position_mm for channel in model.metadata.layout]
    samples = (5 * models.influence_matrix(scene, at_mm, PLACES_MM)).tolist()
    service = start_service("--model", bench_model, "--write-token-file", token_file, "--stale-ms", "60000")
    answers = models.estimate(model, samples)
    for row, sample in enumerate(samples):
        assert service.post(batch_of(sample, sequence=row + 1, channels=model.channels), "bench").status_code == 200
        contact = service.get("/contact").json()
        told = {name: round(float(values[row]), 4) for name, values in answers.items()}
        assert contact["state"] == "contact", contact
        assert contact["misfit"] == round(told.pop("misfit"), 2)
        assert {name: contact[name] for name in FIGURES} == {name: told[name] for name in FIGURES}
    assert np.all(answers["position_low_mm"] < PLACES_MM)
    assert np.all(answers["position_high_mm"] > PLACES_MM)
