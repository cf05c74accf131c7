"""Noise of a reading and of a sample, and the filter between them that fits the latency of a scene."""

import math

from beamtouch_common.digits import digits
from beamtouch_models.errors import SceneError
from beamtouch_models.filters import Chain, chosen_stages, readings_within, unit_of
from beamtouch_models.metadata import FilterChoice, Noise
from beamtouch_models.physics.beam import max_deflection_mm
from beamtouch_models.pricing.rounding import rounding_of
from beamtouch_models.scene import Scene

SPIKE_SIGMAS = 6.0
"""Distance from the median of three, in standard deviations, of a spike; noise reaches it once in 1e8 readings."""

GAIN_ERROR = 0.003
"""Relative gain error that is left after calibration, if the scene does not state it."""
ZERO_SHARE = 0.2
"""Drift of the zero since the last tare over the noise of a reading, if the scene does not state it."""

MAX_READINGS = 10_000
"""Longest filter of the daemon."""

MIN_NOISE, MAX_NOISE = 1e-6, 1e3
"""Bounds of a sample's noise over the largest deflection. A model takes its samples in float32, which resolves 6e-8;
with a noise of a thousand times the deflection, a sample carries no information."""
MIN_DEFLECTION_MM, MAX_DEFLECTION_MM = 1e-9, 1e9
"""Bounds of a beam's largest deflection, with a wide margin; their squares fit float32."""


def sensor_noise_mm(scene: Scene) -> float:
    """Standard deviation of one reading, in mm, without the ADC's steps."""
    if scene.sensors.noise_mm is not None:
        return scene.sensors.noise_mm
    return (scene.sensors.noise_percent_of_max or 0.0) / 100 * max_deflection_mm(scene)


def reading_noise_mm(scene: Scene) -> float:
    """Standard deviation of one reading, in mm: the sensor's noise, and the ADC's steps if the scene states them.

    A step of width q adds q / sqrt(12); Widrow & Kollar, Quantization Noise, 2008, sec. 1.2.
    """
    return math.hypot(sensor_noise_mm(scene), adc_step_mm(scene) / math.sqrt(12))


def adc_step_mm(scene: Scene) -> float:
    """Return the gap per count in mm; 0 if the scene does not state the ADC."""
    sensors = scene.sensors
    return 0.0 if sensors.adc_bits is None else step_mm(sensors.range_mm, sensors.adc_bits)


def rounding_mm(scene: Scene) -> float:
    """Standard deviation in mm of the error that rounding to counts leaves in the mean of any number of readings."""
    return rounding_of(sensor_noise_mm(scene), adc_step_mm(scene))


def zero_drift_mm(scene: Scene) -> float:
    """Standard deviation of a zero since the last tare, in mm; ZERO_SHARE of a reading's noise if it is not stated."""
    stated = scene.sensors.zero_drift_mm
    return ZERO_SHARE * reading_noise_mm(scene) if stated is None else stated


def temperature_drift_mm(scene: Scene) -> float:
    """Standard deviation of a zero's drift with the temperature, in mm; 0 if the scene does not state it.

    The temperatures of the last tare and of a sample are independent and uniform over the range, so their difference
    has the standard deviation range / sqrt(6).
    """
    range_k, drift_um_per_k = scene.environment.temperature_range_k, scene.sensors.drift_um_per_k
    if range_k is None or drift_um_per_k is None:
        return 0.0
    return 1e-3 * drift_um_per_k * (range_k[1] - range_k[0]) / math.sqrt(6)


def floor_of(scene: Scene) -> tuple[float, float]:
    """Return the relative gain error and the error of the zero in mm, as standard deviations per channel.

    They stay when readings are averaged. The gain error is GAIN_ERROR if the scene does not state it. The error of the
    zero is its drift, also with the temperature, with the rounding of the ADC that the noise does not average out.
    """
    percent = scene.sensors.gain_error_percent
    gain = GAIN_ERROR if percent is None else percent / 100
    return gain, math.hypot(math.hypot(zero_drift_mm(scene), temperature_drift_mm(scene)), rounding_mm(scene))


def step_mm(range_mm: tuple[float, float], adc_bits: int) -> float:
    """Gap per count in mm; the linear range takes the middle 80 % of the ADC's scale, so that its ends show."""
    low, high = range_mm
    full_scale: int = 2**adc_bits - 1
    return (high - low) / (0.8 * full_scale)


def choose_filter(scene: Scene) -> FilterChoice:
    """Choose the filter: the mean since the load last changed, made for as many readings as fit in the latency.

    A mean of that many readings has the noise that the model is made for. If the load rests, the mean grows on. The
    filter holds back the first reading of a new load, so N reading periods after it a mean of N readings has settled,
    whatever the filter. Without noise nothing tells a change from rest, and the mean is of the last readings.

    Raises
    ------
    SceneError
        Not even one reading fits in the latency.
    """
    latency = scene.requirements.latency_ms
    if latency is None:
        return FilterChoice()
    period_ms = 1000 / scene.sensors.rate_hz
    readings = latency / period_ms
    if not readings <= MAX_READINGS:
        message = (
            f"requirements.latency_ms = {latency:g} holds more than {MAX_READINGS} readings at sensors.rate_hz = "
            f"{scene.sensors.rate_hz:g}; lower one of them"
        )
        raise SceneError(message)
    window = math.floor(readings + 1e-9)
    if window < 1:
        message = (
            f"requirements.latency_ms = {latency:g} is shorter than one reading ({period_ms:g} ms); "
            "raise sensors.rate_hz"
        )
        raise SceneError(message)
    return growing(scene, window_filter(scene, window))


def growing(scene: Scene, fixed: FilterChoice) -> FilterChoice:
    """Return a filter whose mean grows on from that of a fixed one; without noise or a latency, the fixed one."""
    if fixed.kind == "none" or reading_noise_mm(scene) == 0:
        return fixed
    return fixed.model_copy(update={"kind": "growing-mean", "longest": longest_mean(scene, fixed.window)})


def longest_mean(scene: Scene, window: int) -> int:
    """Return the largest number of readings in a mean that grows on from one of `window` readings."""
    rate_hz = scene.sensors.rate_hz
    return max(window, readings_within(min(scene.requirements.max_mean_ms, MAX_READINGS * 1e3 / rate_hz), rate_hz))


def window_filter(scene: Scene, window: int) -> FilterChoice:
    """Return a spike filter with the mean of `window` readings; without a stated latency, 1 means no filter."""
    if window == 1 and scene.requirements.latency_ms is None:
        return FilterChoice()
    spike = SPIKE_SIGMAS * reading_noise_mm(scene) or None
    settling_ms = window * 1000 / scene.sensors.rate_hz
    return FilterChoice(kind="moving-average", window=window, spike_mm=spike, settling_ms=settling_ms)


def chain_of(chosen: FilterChoice, channels: int, noise_mm: float, per_count_mm: float, slowest_period: float) -> Chain:
    """Return the filter of a model as the daemon runs it; arguments as those of `Chain`, `per_count_mm` its step."""
    stages = chosen_stages(
        chosen.kind,
        window=chosen.window,
        longest=chosen.max_readings,
        spike_mm=chosen.spike_mm,
        unit_mm=unit_of(noise_mm, per_count_mm, channels),
        slowest_period=slowest_period,
    )
    return Chain(stages, channels, noise_mm, slowest_period, per_count_mm)


def noise_of(scene: Scene, chosen: FilterChoice) -> Noise:
    """Noise of a reading and of a sample: the mean of N independent readings divides it by sqrt(N)."""
    reading = reading_noise_mm(scene)
    return Noise(reading_mm=reading, sample_mm=reading / math.sqrt(chosen.window))


def check_errors(scene: Scene, chosen: FilterChoice) -> None:
    """Raise SceneError as `check_scale`, or if the zeros of a scene's sensors drift too far for any model."""
    deflection_mm = max_deflection_mm(scene)
    check_scale(noise_of(scene, chosen).sample_mm, deflection_mm)
    zero_mm, warmth_mm = zero_drift_mm(scene), temperature_drift_mm(scene)
    if max(zero_mm, warmth_mm) > MAX_NOISE * deflection_mm:
        stated = f"zero_drift_mm = {digits(zero_mm, 3)}"
        if warmth_mm > zero_mm:
            stated = f"drift_um_per_k = {scene.sensors.drift_um_per_k:g}"
        message = (
            f"sensors.{stated} hides the largest deflection, {digits(deflection_mm, 3)} mm; "
            "tare more often, use better sensors or a softer beam"
        )
        raise SceneError(message)


def check_scale(noise_mm: float, max_deflection_mm: float) -> None:
    """Raise SceneError if no model can carry the deflection, or the noise next to it.

    A noise of 0 passes; the caller decides whether it will do.
    """
    if not MIN_DEFLECTION_MM <= max_deflection_mm <= MAX_DEFLECTION_MM:
        message = (
            f"beam: the largest deflection is {digits(max_deflection_mm, 3)} mm, which no sensor measures; check its "
            "length, its rigidity and contact.force_n"
        )
        raise SceneError(message)
    if noise_mm > MAX_NOISE * max_deflection_mm:
        message = (
            f"sensors: a sample's noise of {digits(noise_mm, 3)} mm hides the largest deflection, "
            f"{digits(max_deflection_mm, 3)} mm; use better sensors or a softer beam"
        )
        raise SceneError(message)
    if 0 < noise_mm < MIN_NOISE * max_deflection_mm:
        message = (
            f"sensors: a sample's noise of {digits(noise_mm, 3)} mm is less than 1e-4 % of the largest deflection, "
            f"{digits(max_deflection_mm, 3)} mm, too little for the float32 of a model; state the noise of a real "
            "sensor"
        )
        raise SceneError(message)
