"""The error by the time since a touch, as `build` states it: against the accuracy limit, and against `challenge`."""

from pathlib import Path

import numpy as np
import pytest

from beamtouch_models import cli
from beamtouch_models.design.accuracy.limit import accuracy_limit
from beamtouch_models.design.calibrated import prior_of_model
from beamtouch_models.lab.challenge.judge import judge
from beamtouch_models.lab.challenge.play import DrawnContacts, SimulatedSurface
from beamtouch_models.lab.challenge.ringing import rings
from beamtouch_models.runtime.loading import ModelFile, load

SLOW = """
[beam]
length_mm = 400
youngs_modulus_gpa = 210
width_mm = 25
thickness_mm = 1.7
density_kg_m3 = 7850

[contact]
force_n = [0.5, 4]
position_mm = [20, 380]

[sensors]
count = 4
rate_hz = 100
noise_percent_of_max = 0.2
range_mm = [1, 6]
gain_error_percent = 0
zero_drift_mm = 0

[requirements]
latency_ms = 50
"""


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> ModelFile:
    """The model of a strip that swings at 25 Hz and is read at 100 Hz, with perfect gains and zeros."""
    folder: Path = tmp_path_factory.mktemp("slow")
    (folder / "slow.toml").write_text(SLOW)
    fast = ["--criterion", "eigenvalue-product"]
    assert cli.main(["build", str(folder / "slow.toml"), "-o", str(folder / "slow.onnx"), *fast]) == 0
    return load(folder / "slow.onnx")


def test_a_mean_of_perfect_sensors_errs_by_what_the_noise_of_its_readings_leaves(slow: ModelFile) -> None:
    accuracy, prior = slow.metadata.accuracy, prior_of_model(slow.metadata)
    reading_mm = slow.metadata.noise.reading_mm

    assert [one.readings for one in accuracy.since_touch] == [2, 5, 20, 100]
    for one in accuracy.since_touch:
        least = accuracy_limit(prior.at_noise(reading_mm / one.readings**0.5), 1024, 1)
        assert one.error_percent == pytest.approx(least.value, rel=0.12)
        assert one.error_standard_error is not None
        assert 0 < one.error_standard_error < 0.06 * one.error_percent


def test_a_sudden_touch_errs_as_in_the_challenge(slow: ModelFile) -> None:
    surface, rng = SimulatedSurface.of(slow.metadata), np.random.default_rng(1)
    play = rings(DrawnContacts.of(surface, 64, rng))
    (reading,) = [at for name, at in play.rows if name == "sudden force, 200 ms"]
    said = judge(surface, slow.run, surface.world.readings(play.deflection_mm, play.errors, rng), reading).at([reading])
    off = np.abs(said.place_mm - play.truth_mm[:, reading])[:, 0] / surface.world.structure.length_mm * 100

    stated = slow.metadata.accuracy.since_touch[2]

    assert stated.since_ms == pytest.approx(200)
    assert stated.ringing_percent is not None
    assert stated.ringing_standard_error is not None
    scatter = np.hypot(stated.ringing_standard_error, off.std() / len(off) ** 0.5)
    assert stated.ringing_percent == pytest.approx(off.mean(), abs=3 * scatter)
    assert off.mean() > 3 * scatter + stated.error_percent
