"""The daemon config that belongs to a model, as the daemon itself reads it, in front of the rig."""

import math
from pathlib import Path

import numpy as np
import pytest

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.building.daemon_config import daemon_config
from beamtouch_models.metadata import Metadata
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.pricing.noise import step_mm
from beamtouch_models.rig.loads import Load
from beamtouch_models.rig.surface import VirtualSurface
from beamtouch_models.scene import load_scene
from beamtouch_service.samples import Quality
from example_scenes import SCENES


def surface_of(metadata: Metadata, folder: Path) -> Surface:
    path = folder / "daemon.toml"
    path.write_text(daemon_config(metadata))
    (surface,) = load_config(path).surfaces.values()
    return surface


def test_it_states_the_noise_of_a_reading(bench: ModelFile, tmp_path: Path) -> None:
    assert surface_of(bench.metadata, tmp_path).noise_mm == bench.metadata.noise.reading_mm > 0


def test_it_states_the_slowest_period_of_the_beam(bench: ModelFile, tmp_path: Path) -> None:
    assert surface_of(bench.metadata, tmp_path).slowest_period_ms == pytest.approx(98.0, rel=1e-3)
    massless = bench.metadata.scene.replace("density_kg_m3", "# ")
    without = bench.metadata.model_copy(update={"scene": massless})
    assert surface_of(without, tmp_path).slowest_period_ms is None


def test_a_scene_without_noise_states_none(bench: ModelFile, tmp_path: Path) -> None:
    quiet = bench.metadata.noise.model_copy(update={"reading_mm": 0.0})
    fixed = bench.metadata.filter.model_copy(update={"kind": "moving-average", "longest": None})
    surface = surface_of(bench.metadata.model_copy(update={"noise": quiet, "filter": fixed}), tmp_path)
    assert surface.noise_mm is None


def with_adc(metadata: Metadata, bits: int) -> Metadata:
    """The same sensors with another ADC, whose steps are in the noise of a reading."""
    gain = step_mm(metadata.sensor.range_mm, bits)
    offset = metadata.sensor.range_mm[0] - 0.1 * (2**bits - 1) * gain
    sensor = metadata.sensor.model_copy(update={"adc_bits": bits, "gain_mm_per_count": gain, "offset_mm": offset})
    reading = math.hypot(metadata.noise.reading_mm, gain / math.sqrt(12))
    noise = metadata.noise.model_copy(update={"reading_mm": reading})
    return metadata.model_copy(update={"sensor": sensor, "noise": noise})


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_the_rig_is_never_stuck_by_it_and_a_frozen_channel_is(bits: int, bench: ModelFile, tmp_path: Path) -> None:
    metadata = with_adc(bench.metadata, bits)
    pipeline = Pipeline(surface_of(metadata, tmp_path))
    scene, _ = load_scene(SCENES / "bench.toml")
    device = VirtualSurface(scene, metadata, 1)
    counts = np.array([device.counts(Load(120.0, 9.0), 0.0) for _ in range(6000)], dtype=float)
    counts[5000:, 2] = counts[5000, 2]
    readings = [Reading(index / 200, tuple(row)) for index, row in enumerate(counts.tolist())]
    qualities = [taken.sample.quality for taken in pipeline.process(readings, 0.0)]
    assert all(quality is Quality.GOOD for row in qualities[:5000] for quality in row)
    assert qualities[-1] == [Quality.GOOD, Quality.GOOD, Quality.STUCK, Quality.GOOD]
