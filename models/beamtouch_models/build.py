"""From a scene to a model file: filter, layout, training, accuracy beside the limit, golden answers."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray

from beamtouch_models import export, limit
from beamtouch_models.beam import check_small_angles, max_deflection_mm, travel_mm
from beamtouch_models.effects import required
from beamtouch_models.errors import SceneError
from beamtouch_models.modelfile import (
    Accuracy,
    Answers,
    Channel,
    Golden,
    Metadata,
    Noise,
    Ranges,
    Sensor,
)
from beamtouch_models.network import Network, Simulator, train
from beamtouch_models.noise import choose_filter, noise_of, step_mm
from beamtouch_models.placement import Placement, fewest_sensors
from beamtouch_models.scene import Scene

Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
"""Called with what is being done and the fraction of the whole that is done."""

TRAINING_STEPS = 12_000
ACCURACY_DRAWS = 4_000
CALIBRATION_DRAWS = 40_000
REST_DRAWS = 1_000_000
FALSE_ALARM_RATE = 1e-5
DEFAULT_ADC_BITS = 16
ESTIMATOR = "quantile-network"


@dataclass(frozen=True)
class Built:
    """A finished build."""

    content: bytes
    metadata: Metadata
    placement: Placement


def build(scene: Scene, text: str, name: str, *, count: int | None, seed: int, progress: Progress) -> Built:
    """Build the model of a scene.

    Parameters
    ----------
    scene, text, name : the scene, the TOML it was read from, and the name of the surface
    count : number of sensors; None takes the scene's
    seed : of everything random; the same seed gives the same bytes
    progress : told what is being done

    Raises
    ------
    SceneError
        The scene cannot be built; the message says why.
    """
    check_small_angles(scene)
    chosen = choose_filter(scene)
    noise = noise_of(scene, chosen)
    if noise.sample_mm == 0:
        message = "sensors: a noise of 0 leaves nothing to train on; state the noise of a reading"
        raise SceneError(message)
    sensor = sensor_of(scene)
    # Physics ends here: what follows has only the effects that the scene requires.
    physics = required(scene)
    noise = noise_of(physics, chosen)
    progress("placing the sensors", 0.0)
    placement = fewest_sensors(physics, noise.sample_mm, count, seed)
    positions = np.array(placement.positions_mm)
    network, may_miss_one = _trained(physics, positions, noise, seed, progress)
    progress("measuring the accuracy against the limit", 0.9)
    graph = export.network_graph(network, with_force=scene.wants_force)
    run = _runner(export.to_bytes(graph))
    metadata = Metadata(
        name=name,
        estimator=ESTIMATOR,
        length_mm=scene.beam.length_mm,
        layout=[Channel(name=f"s{i}", position_mm=x) for i, x in enumerate(placement.positions_mm, start=1)],
        min_channels=len(positions) - may_miss_one,
        ranges=Ranges(position_mm=scene.contact.position_mm, force_n=scene.contact.force_range_n),
        max_deflection_mm=max_deflection_mm(scene),
        noise=noise,
        filter=chosen,
        sensor=sensor,
        contact_threshold=_contact_threshold(network, len(positions), noise.sample_mm, seed),
        seed=seed,
        accuracy=_accuracy(physics, positions, noise.sample_mm, run, seed),
        golden=_golden(physics, positions, noise.sample_mm, run, seed),
        scene=text,
    )
    return Built(export.to_bytes(graph, metadata), metadata, placement)


def sensor_of(scene: Scene) -> Sensor:
    """Sensor, ADC and stand-off of a scene; raises SceneError where the beam's travel leaves the sensor's range."""
    low, high = scene.sensors.range_mm
    lift, travel = travel_mm(scene)
    standoff = scene.sensors.standoff_mm
    if standoff is None:
        standoff = (low + high) / 2 + (travel - lift) / 2
    if standoff - travel < low or standoff + lift > high:
        message = (
            f"the beam travels {travel + lift:.4g} mm and with a stand-off of {standoff:.4g} mm leaves "
            f"sensors.range_mm = [{low:g}, {high:g}]; make the beam stiffer, the force smaller, "
            "or take a sensor with a longer range"
        )
        raise SceneError(message)
    bits = scene.sensors.adc_bits or DEFAULT_ADC_BITS
    gain = step_mm(scene.sensors.range_mm, bits)
    return Sensor(
        rate_hz=scene.sensors.rate_hz,
        range_mm=scene.sensors.range_mm,
        standoff_mm=standoff,
        adc_bits=bits,
        gain_mm_per_count=gain,
        offset_mm=low - 0.1 * (2**bits - 1) * gain,
    )


def _trained(scene: Scene, positions: Array, noise: Noise, seed: int, progress: Progress) -> tuple[Network, bool]:
    """Train the network; returns it and whether it can do without one channel."""
    # Position and, where it is unknown, force must still be determined without the missing channel.
    may_miss_one = len(positions) > (1 if scene.contact.force_is_known else 2)
    simulator = Simulator(scene, positions, noise.sample_mm, may_miss_one=may_miss_one)
    network = train(
        simulator,
        seed,
        TRAINING_STEPS,
        lambda step: progress("training the network", 0.05 + 0.85 * step / TRAINING_STEPS),
    )
    return _with_calibrated_widths(network, simulator, seed + 1), may_miss_one


def _with_calibrated_widths(network: Network, simulator: Simulator, seed: int) -> Network:
    """Scale the intervals so that they hold the truth in 95 % of fresh simulated cases (split conformal prediction)."""
    rng = np.random.default_rng(seed)
    drawn = simulator.draw(rng, CALIBRATION_DRAWS, touched=True)
    raw = network.raw(network.inputs.features(drawn.deflection_mm, drawn.valid)).astype(np.float64)
    centre, half = network.position_scale
    log_force = np.log(drawn.force_n) - network.inputs.log_length(drawn.deflection_mm, drawn.valid)
    widths = []
    for columns, target in ((raw[:, 0:3], (drawn.position_mm - centre) / half), (raw[:, 4:7], log_force)):
        error = target - columns[:, 0]
        width = np.logaddexp(np.where(error < 0, columns[:, 1], columns[:, 2]), 0)
        widths.append(float(np.quantile(np.abs(error) / width, 0.95)))
    return replace(network, width=(widths[0], widths[1]))


def _contact_threshold(network: Network, channels: int, noise_mm: float, seed: int) -> float:
    """Log odds that a beam at rest exceeds once in 1 / FALSE_ALARM_RATE samples."""
    rng = np.random.default_rng(seed + 2)
    odds = []
    for _ in range(REST_DRAWS // 50_000):
        rest = rng.normal(scale=noise_mm, size=(50_000, channels)).astype(np.float32)
        odds.append(network.raw(network.inputs.features(rest, np.ones(rest.shape, np.bool_)))[:, 3])
    return float(np.quantile(np.concatenate(odds), 1 - FALSE_ALARM_RATE))


def _runner(content: bytes) -> Callable[[NDArray[np.float32], NDArray[np.bool_]], Answers]:
    session = ort.InferenceSession(content, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]

    def run(deflection_mm: NDArray[np.float32], valid: NDArray[np.bool_]) -> Answers:
        return dict(zip(names, session.run(None, {"deflection_mm": deflection_mm, "valid": valid}), strict=True))

    return run


def _accuracy(
    scene: Scene,
    positions: Array,
    noise_mm: float,
    run: Callable[[NDArray[np.float32], NDArray[np.bool_]], Answers],
    seed: int,
) -> Accuracy:
    """Error of the exported graph and the accuracy limit, on the same draws."""
    drawn = limit.draw(scene, positions, noise_mm, ACCURACY_DRAWS, seed + 3)
    deflection = drawn.deflection_mm.astype(np.float32)
    answers = run(deflection, np.ones(deflection.shape, np.bool_))
    reached = limit.mean_error(scene, drawn, answers["position_mm"].astype(np.float64))
    best = limit.mean_error(scene, drawn, limit.posterior_median_mm(scene, positions, noise_mm, drawn.deflection_mm))
    return Accuracy(
        error_percent=reached.percent,
        error_standard_error=reached.standard_error,
        limit_percent=best.percent,
        limit_standard_error=best.standard_error,
    )


def _golden(
    scene: Scene,
    positions: Array,
    noise_mm: float,
    run: Callable[[NDArray[np.float32], NDArray[np.bool_]], Answers],
    seed: int,
) -> Golden:
    """A few contacts and a beam at rest, with what the graph answers."""
    drawn = limit.draw(scene, positions, noise_mm, 8, seed + 4)
    deflection = np.concatenate([drawn.deflection_mm, np.zeros((1, len(positions)))]).astype(np.float32)
    valid = np.ones(deflection.shape, np.bool_)
    answers = run(deflection, valid)
    return Golden(
        deflection_mm=deflection.astype(float).tolist(),
        valid=valid.tolist(),
        answers={name: values.astype(float).tolist() for name, values in answers.items()},
    )
