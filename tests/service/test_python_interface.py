"""The Python interface and the service give the same answer, to the digit."""

from pathlib import Path

import numpy as np

import beamtouch_models as models
from service.bench import FIGURES, Bench, surface_with
from support.surfaces.deflections import deflections_of

PLACES_MM = [60, 150, 300]


def test_scripts_get_what_the_service_answers(bench_model: Path) -> None:
    model = models.load_model(bench_model)
    samples = deflections_of(model, PLACES_MM, [5.0] * len(PLACES_MM)).tolist()
    service = Bench(surface_with(model, "bench"))
    answers = model.estimate(samples)
    for row, sample in enumerate(samples):
        service.send(sample, surface="bench", sequence=row + 1, channels=model.channels)
        contact = service.contact()
        told = {name: round(float(values[row]), 4) for name, values in answers.items()}
        assert contact["state"] == "contact", contact
        assert contact["misfit"] == round(told.pop("misfit"), 2)
        assert {name: contact[name] for name in FIGURES} == {name: told[name] for name in FIGURES}
    assert np.all(answers["position_low_mm"] < PLACES_MM)
    assert np.all(answers["position_high_mm"] > PLACES_MM)
