"""The Python interface and the service give the same answer, to the digit."""

from pathlib import Path

import numpy as np
import pytest

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
        assert contact["state"] == answers["state"][row] == "contact", contact
        told = {name: round(float(values[row]), 4) for name, values in answers.items() if name != "state"}
        assert contact["misfit"] == round(told.pop("misfit"), 2)
        assert {name: contact[name] for name in FIGURES} == {name: told[name] for name in FIGURES}
    assert np.all(answers["position_low_mm"] < PLACES_MM)
    assert np.all(answers["position_high_mm"] > PLACES_MM)


@pytest.mark.promise(
    "docs/reference/python.md",
    "`state` is the word of the service's answer, and figures of a contact are NaN where there is none.",
)
@pytest.mark.parametrize(
    "sample",
    [
        [0.0, 0.0, 0.0, 0.0],
        [0.3, 0.5, 0.5, 0.3],
        [0.5, -0.5, 0.5, -0.5],
        [0.4, None, 0.9, 0.6],
        [None, 0.0, 0.001, 0.0],
        "load",
        "load without s2",
    ],
)
def test_a_script_gets_the_state_that_the_service_answers(bench_model: Path, sample: list[float | None] | str) -> None:
    model = models.load_model(bench_model)
    if isinstance(sample, str):
        known = deflections_of(model, [150], [5.0])[0].tolist()
        sample = [None if place == 1 and "without" in sample else mm for place, mm in enumerate(known)]
    service = Bench(surface_with(model, "bench"))
    quality = ["missing" if mm is None else "good" for mm in sample]
    for number in range(1, 7):
        service.send(sample, surface="bench", sequence=number, channels=model.channels, quality=quality)
    contact = service.contact()
    answers = model.estimate([np.nan if mm is None else mm for mm in sample])
    assert contact["state"] == answers["state"][0]
    assert answers["channels"][0] == len(sample) - sample.count(None)
    for name in FIGURES:
        assert (contact[name] is None) == bool(np.isnan(answers[name][0]))
        assert contact[name] is None or contact[name] == pytest.approx(answers[name][0], abs=1e-4)
