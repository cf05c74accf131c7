"""The daemon config that belongs to a model, as the daemon itself reads it, in front of the rig."""

import math
from pathlib import Path

import numpy as np
import pytest

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models import cli
from beamtouch_models.design.building.daemon_config import daemon_config
from beamtouch_models.design.pricing.noise import step_mm
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import VirtualSurface
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata import Metadata
from beamtouch_service.samples import Quality
from models import quick_model
from support.surfaces.example_scenes import SCENES


def surface_of(metadata: Metadata, folder: Path) -> Surface:
    path = folder / "daemon.toml"
    path.write_text(daemon_config(metadata))
    (surface,) = load_config(path).surfaces.values()
    return surface


def test_it_states_what_the_model_was_made_for(bench: ModelFile, tmp_path: Path) -> None:
    metadata, surface = bench.metadata, surface_of(bench.metadata, tmp_path)
    assert [(one.name, one.register_) for one in surface.channels] == [("s1", 0), ("s2", 1), ("s3", 2), ("s4", 3)]
    sensor = metadata.sensor
    for channel in surface.channels:
        stated = (channel.gain_mm_per_count, channel.offset_mm, channel.rest_gap_mm, tuple(channel.range_mm))
        assert stated == (sensor.gain_mm_per_count, sensor.offset_mm, sensor.standoff_mm, sensor.range_mm)
    # The outer sensors yield less than the inner ones, and the mirrored ones as much.
    outer, inner, *others = (channel.smallest_force_mm or 0.0 for channel in surface.channels)
    assert others == pytest.approx([inner, outer], rel=1e-3)
    assert 0 < outer < inner
    assert (surface.beam, surface.rate_hz) == (metadata.beam, sensor.rate_hz)
    assert surface.noise_mm == metadata.noise.reading_mm
    assert surface.slowest_period_ms == pytest.approx(98.0, rel=1e-3)
    assert surface.zero_drift_mm == pytest.approx(0.001, rel=0.01)
    assert surface.zero_tracking is not None  # the noise of a reading in a minute, and half of what 2 N cause
    assert surface.zero_tracking.drift_um_per_min == pytest.approx(1e3 * metadata.noise.reading_mm, rel=1e-2)
    assert surface.zero_tracking.max_mm == pytest.approx(outer / 2, rel=1e-2)
    assert surface.loads is not None
    assert (surface.loads.ranges_mm, surface.loads.max_force_n) == ({"position": (1.0, 399.0)}, 20.0)


def test_what_the_scene_does_not_state_has_no_line(bench: ModelFile, tmp_path: Path) -> None:
    fixed = bench.metadata.filter.model_copy(update={"kind": "moving-average", "longest": None})
    unstated = {
        "noise": bench.metadata.noise.model_copy(update={"reading_mm": 0.0}),
        "filter": fixed,
        "scene": bench.metadata.scene.replace("density_kg_m3", "# "),
    }
    surface = surface_of(bench.metadata.model_copy(update=unstated), tmp_path)
    assert (surface.noise_mm, surface.slowest_period_ms, surface.zero_tracking) == (None, None, None)


@pytest.mark.parametrize("bits", [12, None])
def test_the_bits_of_the_adc_are_those_of_the_scene(bits: int | None, bench: ModelFile, tmp_path: Path) -> None:
    scene = bench.metadata.scene if bits is None else bench.metadata.scene.replace("rate_hz", "adc_bits = 12\nrate_hz")
    surface = surface_of(bench.metadata.model_copy(update={"scene": scene}), tmp_path)
    assert {channel.adc_bits for channel in surface.channels} == {bits}


def test_counts_are_those_of_the_adc_that_is_stated_however_small_its_steps(tmp_path: Path) -> None:
    """The steps of 14 bits are a thirtieth of the noise, so that `explain` calls them negligible."""
    scene, config = tmp_path / "quick.toml", tmp_path / "daemon.toml"
    scene.write_text(quick_model.SCENE.replace("[sensors]", "[sensors]\nadc_bits = 14"))
    files = ("-o", tmp_path / "quick.onnx", "--daemon-config", config)
    assert (
        cli.main(["build", str(scene), *map(str, files), "--criterion", "eigenvalue-product", "--effort", "0.01"]) == 0
    )

    (surface,) = load_config(config).surfaces.values()

    # The linear range of 1 to 4 mm is the middle 80 % of the scale.
    for channel in surface.channels:
        assert channel.offset_mm is not None
        assert channel.gain_mm_per_count is not None
        ends = [channel.offset_mm + channel.gain_mm_per_count * count for count in (0, 2**14 - 1)]
        assert ends == pytest.approx([0.625, 4.375])


def with_adc(metadata: Metadata, bits: int) -> Metadata:
    """The same sensors with another ADC, whose steps are in the noise of a reading."""
    gain = step_mm(metadata.sensor.range_mm, bits)
    offset = metadata.sensor.range_mm[0] - 0.1 * (2**bits - 1) * gain
    sensor = metadata.sensor.model_copy(update={"adc_bits": bits, "gain_mm_per_count": gain, "offset_mm": offset})
    reading = math.hypot(metadata.noise.reading_mm, gain / math.sqrt(12))
    noise = metadata.noise.model_copy(update={"reading_mm": reading})
    return metadata.model_copy(update={"sensor": sensor, "noise": noise})


@pytest.mark.parametrize("bits", [8, pytest.param(16, marks=pytest.mark.soak)])
def test_the_rig_is_never_stuck_by_it_and_a_frozen_channel_is(bits: int, bench: ModelFile, tmp_path: Path) -> None:
    metadata = with_adc(bench.metadata, bits)
    pipeline = Pipeline(surface_of(metadata, tmp_path))
    scene, _ = load_scene(SCENES / "bench.toml")
    device = VirtualSurface(scene, metadata, 1)
    counts = np.array([device.counts(Load(120.0, 9.0), 0.0) for _ in range(3000)], dtype=float)
    counts[2500:, 2] = counts[2500, 2]
    readings = [Reading(index / 200, tuple(row)) for index, row in enumerate(counts.tolist())]
    qualities = [taken.sample.quality for taken in pipeline.process(readings, 0.0)]
    assert all(quality is Quality.GOOD for row in qualities[:2500] for quality in row)
    assert qualities[-1] == [Quality.GOOD, Quality.GOOD, Quality.STUCK, Quality.GOOD]
