"""The steps of the guide from a surface whose sensors are off to a calibrated model, pasted as they stand there."""

import json
from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import runtime
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.lab.rig.surface import load_imperfections
from support.pages.pasted import ROOT, blocks_of, paste
from support.programs.toolchain import need
from support.surfaces.unlabelled_contacts import missed_mm

pytestmark = [pytest.mark.long, pytest.mark.soak, pytest.mark.timeout(900)]

GUIDE = "docs/how-to/calibrate-without-loads.md"
ENOUGH = 40
"""Contacts to expect: the guide waits for fifty, a few of which may not count."""


def test_the_steps_of_the_guide_calibrate_a_surface(tmp_path: Path) -> None:
    need("curl")
    (tmp_path / "models").symlink_to(ROOT / "models")
    (shown,) = [block.text for block in blocks_of(GUIDE) if block.word == "text"]

    printed = paste(GUIDE, tmp_path, patience_s=800)

    folder = tmp_path / "build" / "off"
    assert (folder / "bench.onnx").read_bytes() == (folder / "bench-real.onnx").read_bytes()
    model = runtime.load(folder / "bench-real.onnx")
    metadata = model.metadata
    start = printed.index('{"', printed.index("misfit"))
    in_use, _ = json.JSONDecoder().raw_decode(printed, start)
    assert in_use["identity"] == model.identity
    calibration = metadata.calibration
    assert calibration is not None
    assert calibration.contacts >= ENOUGH
    said = printed[printed.rindex("model ", 0, printed.index("\ncontacts ")) :]
    assert first_words(shown) == [word for word in first_words(said) if word in first_words(shown)]
    assert calibration.misfit_before is not None
    assert calibration.misfit_after is not None
    assert calibration.misfit_after < 0.5 * calibration.misfit_before
    nominal, real = NominalSurface.of(metadata), load_imperfections(folder / "off.toml")
    missed_before, missed_after = (
        missed_mm(nominal, vector, metadata, real)
        for vector in (np.zeros(nominal.size), nominal.vector_of(calibration.departures))
    )
    assert missed_after < 0.5 * missed_before


def first_words(text: str) -> list[str]:
    """Return the first word of each line."""
    return [line.split()[0] for line in text.splitlines() if line.strip()]
