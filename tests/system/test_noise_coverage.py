"""What `noise` prints, put into the scene and the daemon's configuration, gives intervals that hold the truth."""

import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing.noise_keys import Keys, keys_of
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.processing.rest_checks import at_rest
from beamtouch_daemon.processing.rest_noise import measured
from beamtouch_daemon.processing.tare import rest_gaps
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.building.build import sensor_of
from beamtouch_models.export import to_bytes
from beamtouch_models.metadata import Sensor
from beamtouch_models.physics.beam import scene_influence
from beamtouch_models.placement import place
from beamtouch_models.pricing.effects import required
from beamtouch_models.pricing.noise import choose_filter
from beamtouch_models.rig.surface import counts_of_gap
from beamtouch_models.scene import Scene, parse_scene
from beamtouch_models.session import Run, runner
from beamtouch_models.whitening import whitening
from beamtouch_service.samples import triangle_rows
from example_scenes import SCENES
from posterior_cases import graph_of

TOUCHES, SETTLED = 600, 40


def scene_with(**sensors: object) -> Scene:
    """The bench scene with other sensors, none of whose errors but the noise matters."""
    stated: dict[str, Any] = tomllib.loads((SCENES / "bench.toml").read_text())
    for key in ("noise_percent_of_max", "gain_error_percent", "zero_drift_mm"):
        del stated["sensors"][key]
    stated["sensors"] |= {"gain_error_percent": 0.0} | sensors
    return parse_scene(tomli_w.dumps(stated), "scene")


@dataclass
class Line:
    """Sensors with noise of a standard deviation and a correlation between successive readings, and their ADC."""

    sensor: Sensor
    noise_mm: float
    alike: float
    seed: int

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)

    def counts(self, deflection_mm: Floats, readings: int, offset_mm: Floats | float = 0.0) -> Floats:
        """Counts (readings, channels) under a deflection (channels,)."""
        shape = (readings, len(deflection_mm))
        noise, fresh = np.empty(shape), self._rng.standard_normal(shape)
        noise[0] = fresh[0]
        for index in range(1, readings):
            noise[index] = self.alike * noise[index - 1] + np.sqrt(1 - self.alike**2) * fresh[index]
        gap = self.sensor.standoff_mm + offset_mm - deflection_mm + self.noise_mm * noise
        return counts_of_gap(self.sensor, gap).astype(np.float64)


def surface_of(sensor: Sensor, scene: Scene, window: int, channels: int, **keys: object) -> Surface:
    values = {
        "rate_hz": scene.sensors.rate_hz,
        "source": {"kind": "modbus-tcp", "host": "127.0.0.1"},
        "filter": {"kind": "moving-average", "window": window},
        "channels": [
            {
                "name": f"s{index + 1}",
                "register": index,
                "gain_mm_per_count": sensor.gain_mm_per_count,
                "offset_mm": sensor.offset_mm,
                "rest_gap_mm": sensor.standoff_mm,
                "range_mm": list(sensor.range_mm),
                "adc_bits": sensor.adc_bits,
            }
            for index in range(channels)
        ],
    }
    return Surface.model_validate(values | keys)


@dataclass
class Model:
    """A model of the bench scene without the rest of a build."""

    scene: Scene
    layout: Floats

    def __post_init__(self) -> None:
        chosen = choose_filter(self.scene)
        physics = required(self.scene, chosen)
        self.window = chosen.window
        self.prior = Prior.real(physics.scene, self.layout, physics.noise.sample_mm)
        self.run: Run = runner(to_bytes(graph_of(self.prior)))


def held(model: Model, line: Line, surface: Surface, rng: np.random.Generator, tare_noise_mm: float | None = None) -> tuple[float, float, float]:
    """Share of touches whose interval holds the truth, share of samples that move, and the median width in mm."""
    low, high = model.scene.contact.force_range_n
    characteristic = Characteristic.of(surface.channels)
    inside, widths, moving = [], [], 0
    for _ in range(TOUCHES):
        at_mm, force = rng.uniform(20, 380), rng.uniform(low, high)
        offset = rng.uniform(-0.05, 0.05, len(model.layout))  # each mounting has its own place within a count
        rest_counts = line.counts(np.zeros(len(model.layout)), 200, offset)
        rest = rest_gaps(rest_counts, characteristic, surface.channel_names, tare_noise_mm)
        deflection = force * scene_influence(model.scene, model.layout, at_mm)[0]
        counts = line.counts(deflection, SETTLED, offset)
        readings = [Reading(index / surface.rate_hz, tuple(row)) for index, row in enumerate(counts.tolist())]
        sample = Pipeline(surface, rest).process(readings, 0.0)[-1].sample
        mean = np.array([sample.deflection_mm], dtype=np.float64)
        assert sample.readings is not None
        covariance = np.eye(len(model.layout)) * (surface.noise_mm or 0.0) ** 2 / sample.readings
        if sample.covariance_mm2 is not None:
            moving += 1
            rows = triangle_rows(sample.covariance_mm2)
            covariance = np.array([[rows[max(i, j)][min(i, j)] for j in range(len(rows))] for i in range(len(rows))])
        weights = whitening(mean, covariance, model.prior.gain, model.prior.zero_mm)
        answer = model.run(mean, weights)
        bounds = answer["position_low_mm"][0], answer["position_high_mm"][0]
        inside.append(bounds[0] <= at_mm <= bounds[1])
        widths.append(bounds[1] - bounds[0])
    return float(np.mean(inside)), moving / TOUCHES, float(np.median(widths))


