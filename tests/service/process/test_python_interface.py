"""The Python interface and the service give the same answer, to the digit, also of a calibrated model."""

from pathlib import Path

import numpy as np
import pytest

import beamtouch_models as models
from beamtouch_models import cli
from imperfect_surface import imperfections, readings
from service.conftest import MakeBatch
from service.process.conftest import StartService

PLACES_MM, OFFSET_MM = [60, 150, 300], 0.02
FIGURES = [
    "position_mm", "position_low_mm", "position_high_mm", "force_n", "force_low_n", "force_high_n",
]  # fmt: skip


@pytest.mark.usefixtures("short_measuring")
def test_scripts_get_what_the_service_answers(
    bench_model: Path, start_service: StartService, make_batch: MakeBatch, token_file: Path, tmp_path: Path
) -> None:
    model = models.load_model(bench_model)
    real = imperfections(4, model.metadata).model_copy(update={"offset_mm": (OFFSET_MM, -OFFSET_MM, 0.0, 0.0)})
    loads, output = readings(tmp_path, model, real), tmp_path / "press-7.onnx"
    assert cli.main(["calibrate", str(bench_model), str(loads), "-o", str(output)]) == 0
    fresh = models.load_model(output)
    calibration = fresh.metadata.calibration
    assert calibration is not None
    assert max(map(abs, calibration.departures.offset_mm)) > OFFSET_MM / 2
    scene = models.read_scene(fresh.metadata.scene + "\n")
    truth = 5 * models.influence_matrix(scene, [channel.position_mm for channel in fresh.metadata.layout], PLACES_MM)
    departures = real.departures(len(fresh.channels))
    samples = departures.measure(np.array(departures.gain) * truth).tolist()

    (tmp_path / "service.toml").write_text(f'[surfaces.press-7]\nmodel = "{output}"\n')
    service = start_service("--config", "service.toml", "--write-token-file", token_file)
    answers = models.estimate(fresh, samples)

    for row, sample in enumerate(samples):
        service.post(make_batch(sample, sequence=row + 1, channels=fresh.channels))
        contact = service.get("/contact").json()
        told = {name: round(float(values[row]), 4) for name, values in answers.items()}
        assert contact["state"] == "contact", contact
        assert contact["misfit"] == round(told.pop("misfit"), 2)
        assert {name: contact[name] for name in FIGURES} == {name: told[name] for name in FIGURES}
    assert np.all(answers["position_low_mm"] < PLACES_MM)
    assert np.all(answers["position_high_mm"] > PLACES_MM)
