"""The steps of the README from a surface whose sensors are off to a calibrated model, typed as they stand there."""

from pathlib import Path

import httpx2
import numpy as np
import pytest

from beamtouch_models import modelfile
from beamtouch_models.building.model_prior import physics_of
from beamtouch_models.calibration.theory import Theory
from beamtouch_models.rig.imperfections import load_imperfections
from plain_http import TIMEOUT_S
from typed_readme import blocks, shell
from unlabelled_contacts import missed_mm

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

ENOUGH = 40
"""Contacts to wait for: there is one a second, of which a busy machine misses some."""


def has_enough_contacts(url: str) -> bool:
    """Return whether the service has kept enough contacts."""
    try:
        answer = httpx2.get(f"{url}/surfaces/bench/calibration-data", timeout=TIMEOUT_S)
    except httpx2.TransportError:  # it is not up yet
        return False
    return answer.is_success and len(answer.text.splitlines()) > ENOUGH


def model_in_use(url: str) -> str:
    """Return the identity of the model that the service uses."""
    identity: str = httpx2.get(f"{url}/surfaces/bench", timeout=TIMEOUT_S).json()["model"]
    return identity


def test_the_steps_of_the_readme_calibrate_a_surface(tmp_path: Path) -> None:
    prepare, start, calibrate, shown, adopt = blocks("Calibrating without known loads")
    with shell(tmp_path) as typed:
        typed.type(prepare)
        typed.type(start)
        typed.wait_until(lambda: has_enough_contacts(typed.url))
        before = model_in_use(typed.url)
        printed = typed.type(calibrate)
        replace, ask, stop = adopt.splitlines()
        typed.type(replace)
        typed.wait_until(lambda: model_in_use(typed.url) != before)
        typed.type(ask)
        typed.type(stop)
        typed.leave()
    folder = tmp_path / "build" / "off"
    metadata = modelfile.load(folder / "bench-real.onnx").metadata
    calibration = metadata.calibration
    assert calibration is not None
    assert calibration.contacts >= ENOUGH
    assert first_words(shown) == [word for word in first_words(printed) if word in first_words(shown)]
    assert calibration.misfit_before is not None
    assert calibration.misfit_after is not None
    assert calibration.misfit_after < 0.5 * calibration.misfit_before
    theory, real = Theory.of(physics_of(metadata), metadata), load_imperfections(folder / "off.toml")
    missed_before, missed_after = (
        missed_mm(theory, vector, metadata, real)
        for vector in (np.zeros(theory.size), theory.vector_of(calibration.departures))
    )
    assert missed_after < 0.5 * missed_before


def first_words(text: str) -> list[str]:
    """Return the first word of each line."""
    return [line.split()[0] for line in text.splitlines() if line.strip()]
