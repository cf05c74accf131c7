"""What `noise` prints, put into the scene and the daemon's configuration, gives intervals that hold the truth."""

import tomllib
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
import tomli_w

from beamtouch_daemon.config.settings import Surface as Settings
from beamtouch_daemon.measuring.at_rest import select_rest
from beamtouch_daemon.measuring.noise import Keys, keys_of, measure_noise
from beamtouch_daemon.processing.characteristic import Characteristic
from beamtouch_daemon.processing.pipeline import Pipeline
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.arrays import Floats
from beamtouch_models.design.estimators.onnx_graph import to_bytes
from beamtouch_models.design.estimators.posterior.window import posterior_graph
from beamtouch_models.design.physics.beam import influence_matrix
from beamtouch_models.design.placement.placing import place
from beamtouch_models.design.scene import Scene, parse_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.design.world import counts_of_output, output_of_gap
from beamtouch_models.runtime.error_model import whitening
from beamtouch_models.runtime.metadata_parts import Sensor
from beamtouch_models.runtime.session import Run, runner
from support.surfaces.example_scenes import SCENES
from support.surfaces.stated_problems import problem_in, real_prior

CHANNELS, TOUCHES, SETTLED, RECORDED = 4, 400, 40, 12_000


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
        return counts_of_output(self.sensor, output_of_gap(self.sensor, gap)).astype(np.float64)


def surface_of(scene: Scene, sensor: Sensor, keys: Keys | None = None) -> Settings:
    """The daemon's surface, with what `noise` printed."""
    stuck = keys.stuck_after_ms if keys else {}
    stated = {"noise_mm": keys.daemon_noise_mm, "slowest_period_ms": 98.0} if keys else {}
    values = {
        "rate_hz": scene.sensors.rate_hz,
        "source": {"kind": "modbus-tcp", "host": "127.0.0.1"},
        "filter": {"kind": "moving-average", "window": resolve(scene).filter.window},
        "channels": [
            {
                "name": f"s{index + 1}",
                "register": index,
                "gain_mm_per_count": sensor.gain_mm_per_count,
                "offset_mm": sensor.offset_mm,
                "rest_gap_mm": sensor.standoff_mm,
                "range_mm": list(sensor.range_mm),
                "adc_bits": sensor.adc_bits,
                "stuck_after_ms": stuck.get(f"s{index + 1}"),
            }
            for index in range(CHANNELS)
        ],
    }
    return Settings.model_validate(values | stated)


@dataclass
class Model:
    """A model of the bench scene without the rest of a build."""

    scene: Scene
    layout: Floats

    def __post_init__(self) -> None:
        chosen = resolve(self.scene).filter
        physics = resolve(self.scene, chosen=chosen)
        self.window = chosen.window
        self.prior = real_prior(physics.scene, self.layout, physics.noise.sample_mm)
        self.run: Run = runner(
            to_bytes(posterior_graph(self.prior, with_force=self.prior.force_n[0] < self.prior.force_n[1]))
        )


def held(model: Model, line: Line, surface: Settings) -> tuple[float, float]:
    """Share of touches whose interval holds the truth, and share of settled samples that are said to move."""
    rng = np.random.default_rng(1)
    low, high = model.scene.contact.force_range_n
    characteristic = Characteristic.of(surface)
    inside, moving = 0, 0
    for _ in range(TOUCHES):
        at_mm, force = rng.uniform(20, 380), rng.uniform(low, high)
        offset = rng.uniform(-0.05, 0.05, CHANNELS)  # gaps have any place between two counts
        tared = characteristic.gap(line.counts(np.zeros(CHANNELS), 200, offset)).mean(axis=0).tolist()
        counts = line.counts(force * influence_matrix(model.scene, model.layout, at_mm)[0], SETTLED, offset)
        readings = [Reading(index / surface.rate_hz, tuple(row)) for index, row in enumerate(counts.tolist())]
        rest = dict(zip(surface.channel_names, tared, strict=True))
        sample = Pipeline(surface, rest).process(readings, 0.0)[-1].sample
        mean = np.array([sample.deflection_mm], dtype=np.float64)
        assert sample.readings is not None
        assert surface.noise_mm is not None
        covariance = np.eye(CHANNELS) * surface.noise_mm**2 / sample.readings
        if sample.covariance_mm2 is not None:
            moving += 1
            covariance[np.tril_indices(CHANNELS)] = sample.covariance_mm2
            covariance = np.tril(covariance) + np.tril(covariance, -1).T
        answer = model.run(mean, whitening(mean, covariance, model.prior.errors.gain, model.prior.errors.zero_mm))
        inside += bool(answer["position_low_mm"][0] <= at_mm <= answer["position_high_mm"][0])
    return inside / TOUCHES, moving / TOUCHES


@pytest.fixture(scope="session")
def layout() -> Floats:
    return np.array(place(*problem_in(scene_with(noise_mm=0.0045)), CHANNELS, 0).positions_mm)


@pytest.mark.long
@pytest.mark.parametrize(
    ("steps", "noise_mm", "alike"),
    [(16, 0.0045, 0.95), (8, 0.0002, 0.0), pytest.param(9, 0.003, 0.9, marks=pytest.mark.soak)],
    ids=["slow", "coarse ADC", "coloured and coarse"],
)
def test_measured_noise_gives_intervals_that_hold(steps: int, noise_mm: float, alike: float, layout: Floats) -> None:
    real = scene_with(noise_mm=noise_mm, adc_bits=steps)
    line = Line(resolve(real).sensor, noise_mm, alike, 3)
    unmeasured = surface_of(real, line.sensor)
    recording = line.counts(np.zeros(CHANNELS), RECORDED, np.random.default_rng(5).uniform(-0.05, 0.05, CHANNELS))
    keys = keys_of(measure_noise(select_rest(recording, unmeasured, {}), unmeasured), unmeasured)
    bits = {} if keys.adc_bits is None else {"adc_bits": keys.adc_bits}
    printed = scene_with(noise_mm=keys.scene_noise_mm, zero_drift_mm=keys.zero_drift_mm, **bits)
    share, moving = held(Model(printed, layout), line, surface_of(real, line.sensor, keys))
    assert share >= 0.93
    assert moving <= 0.02  # a note; half of a percent is usual
