"""Noise of a reading and of a sample, and the filter between them that fits the latency of a scene."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from beamtouch_common.digits import Rounded, digits
from beamtouch_common.units import MM
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import SceneError
from beamtouch_models.filters import Chain, Mean, readings_within
from beamtouch_models.runtime.metadata_parts import FilterChoice, Noise

SPIKE_SIGMAS = 6.0
"""Distance from the median of three, in standard deviations, of a spike; noise reaches it once in 1e8 readings."""

GAIN_ERROR = 0.003
"""Relative gain error that is left after calibration, if the scene does not state it."""
ZERO_SHARE = 0.2
"""Drift of the zero since the last tare over the noise of a reading, if the scene does not state it."""
MINUTE_SHARE = 1.0
"""Least drift of all zeros in a minute over the noise of a reading, if the scene does not state it."""
HALL_MM_PER_MIN = 0.005
"""Least drift of all zeros, however little noise a sensor has, if the scene does not state it, nor how far zeros drift
from one tare to the next. Brackets and modules in a hall that warms in the morning drift so fast: 10 to 20 um per
kelvin, and a kelvin in two to four minutes."""
LEAST_SHARE = 0.1
"""Largest such drift in a minute, over the largest deflection under the smallest force. A surface on which more would
soon look like a light load stands where the temperature is steady."""

HARMONICS = 1000
"""Harmonics of the rounding error; those beyond it hold 0.03 % of its standard deviation."""
MAX_EXPONENT = 700.0
"""exp(-700) is still a float64."""

MAX_READINGS = 10_000
"""Longest filter of the daemon."""

MIN_NOISE, MAX_NOISE = 1e-6, 1e3
"""Bounds of a sample's noise over the largest deflection. A model takes its samples in float32, which resolves 6e-8;
with a noise of a thousand times the deflection, a sample carries no information."""
MIN_DEFLECTION_MM, MAX_DEFLECTION_MM = 1e-9, 1e9
"""Bounds of a beam's largest deflection, with a wide margin; their squares fit float32."""


@dataclass(frozen=True, repr=False)
class ReadingErrors(Rounded):
    """The errors of a scene's readings, as standard deviations; all but the noise stay when readings are averaged."""

    sensor_mm: float
    """Noise of a reading, without the ADC's steps."""
    step_mm: float
    """Gap per count; 0 if the scene does not state the ADC."""
    gain: float
    """Relative error of the gain that calibration leaves; GAIN_ERROR if the scene does not state it."""
    zero_mm: float
    """Drift of a zero since the last tare; ZERO_SHARE of a reading's noise if the scene does not state it."""
    warmth_mm: float
    """Drift of a zero with the temperature; 0 if the scene does not state it."""
    drift_mm_per_min: float
    """Drift of all zeros together in a minute. If the scene does not state it, MINUTE_SHARE of a reading's noise, and
    for gaps at least HALL_MM_PER_MIN, as far as LEAST_SHARE allows, unless the scene states `zero_mm`."""

    @classmethod
    def of(cls, scene: Scene, max_deflection_mm: float) -> Self:
        """Return the errors that a scene states; a noise in percent is one of `max_deflection_mm`."""
        sensors, percent = scene.sensors, scene.sensors.gain_error_percent
        sensor_mm = sensors.noise_mm
        if sensor_mm is None:
            sensor_mm = (sensors.noise_percent_of_max or 0.0) / 100 * max_deflection_mm
        step = 0.0 if sensors.adc_bits is None else step_mm(sensors.range_mm, sensors.adc_bits)
        gain = GAIN_ERROR if percent is None else percent / 100
        warmth_mm, range_k = 0.0, scene.environment.temperature_range_k
        if range_k is not None and sensors.drift_um_per_k is not None:
            # The temperatures of the last tare and of a sample are independent and uniform over the range, so their
            # difference has the standard deviation range / sqrt(6).
            warmth_mm = 1e-3 * sensors.drift_um_per_k * (range_k[1] - range_k[0]) / math.sqrt(6)
        reading_mm = math.hypot(sensor_mm, step / math.sqrt(12))
        um_per_min = scene.environment.drift_um_per_min
        least_n, largest_n = scene.contact.force_range_n
        usual_mm_per_min = MINUTE_SHARE * reading_mm
        if sensors.zero_drift_mm is None and scene.unit == MM:
            hall_mm_per_min = min(HALL_MM_PER_MIN, LEAST_SHARE * max_deflection_mm * least_n / largest_n)
            usual_mm_per_min = max(usual_mm_per_min, hall_mm_per_min)
        return cls(
            sensor_mm,
            step,
            gain,
            zero_mm=ZERO_SHARE * reading_mm if sensors.zero_drift_mm is None else sensors.zero_drift_mm,
            warmth_mm=warmth_mm,
            drift_mm_per_min=usual_mm_per_min if um_per_min is None else 1e-3 * um_per_min,
        )

    def scaled(self, factor: float) -> Self:
        """Return the errors of readings that are `factor` times as large; the gain is relative."""
        names = "sensor_mm", "step_mm", "zero_mm", "warmth_mm", "drift_mm_per_min"
        return replace(self, **{name: factor * getattr(self, name) for name in names})

    @property
    def reading_mm(self) -> float:
        """Noise of a reading: the sensor's, and that of the ADC's steps if the scene states them.

        A step of q adds q / sqrt(12) (Widrow & Kollar, Quantization Noise, 2008, sec. 1.2).
        """
        return math.hypot(self.sensor_mm, self.step_mm / math.sqrt(12))

    @property
    def drift_mm(self) -> float:
        """Drift of a zero since the last tare, also with the temperature."""
        return math.hypot(self.zero_mm, self.warmth_mm)

    @cached_property
    def rounding_mm(self) -> float:
        """Error that rounding to counts leaves in the mean of any number of readings, as a standard deviation.

        The mean of rounded readings deviates from the gap by a periodic function of it, with the harmonics
        q / (pi k) exp(-2 (pi k s / q)^2) for a step of q and noise of s before rounding (Widrow & Kollar, 2008, ch. 4).
        Without noise it is q / sqrt(12); at s = q / 2 it is gone. It counts twice, as the rest gap, which `tare`
        measures, is rounded too.
        """
        if self.step_mm == 0:
            return 0.0
        order = np.arange(1, HARMONICS + 1)
        decay = np.exp(-np.minimum(2 * (np.pi * order * self.sensor_mm / self.step_mm) ** 2, MAX_EXPONENT))
        single = self.step_mm * math.sqrt(float(np.sum((decay / (np.pi * order)) ** 2)) / 2)
        return math.sqrt(2) * single

    @property
    def floor_mm(self) -> float:
        """Error of a zero in the mean of any number of readings: its drift, with the rounding that stays."""
        return math.hypot(self.drift_mm, self.rounding_mm)

    def behind(self, chosen: FilterChoice) -> Noise:
        """Return the noise of a reading and of a sample: the mean of N independent readings divides it by sqrt(N)."""
        return Noise(reading_mm=self.reading_mm, sample_mm=self.reading_mm / math.sqrt(chosen.window))


def step_mm(range_mm: tuple[float, float], adc_bits: int) -> float:
    """Gap per count in mm; the linear range takes the middle 80 % of the ADC's scale, so that its ends show."""
    low, high = range_mm
    full_scale: int = 2**adc_bits - 1
    return (high - low) / (0.8 * full_scale)


def choose_filter(scene: Scene, reading_mm: float) -> FilterChoice:
    """Choose the filter: the mean since the load last changed, made for as many readings as fit in the latency.

    `reading_mm` is the noise of a reading.

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
    rate_hz = scene.sensors.rate_hz
    period_ms = 1000 / rate_hz
    readings = latency / period_ms
    if not readings <= MAX_READINGS:
        raise SceneError(
            f"requirements.latency_ms = {latency:g} holds more than {MAX_READINGS} readings at sensors.rate_hz = "
            f"{rate_hz:g}; lower one of them"
        )
    window = math.floor(readings + 1e-9)
    if window < 1:
        raise SceneError(
            f"requirements.latency_ms = {latency:g} is shorter than one reading ({period_ms:g} ms); "
            "raise sensors.rate_hz"
        )
    longest = max(window, readings_within(min(scene.requirements.max_mean_ms, MAX_READINGS * 1e3 / rate_hz), rate_hz))
    return FilterChoice(
        kind="growing-mean" if reading_mm else "moving-average",
        window=window,
        longest=longest if reading_mm else None,
        spike_mm=SPIKE_SIGMAS * reading_mm or None,
        settling_ms=window * 1000 / rate_hz,
    )


def chain_of(
    chosen: FilterChoice,
    channels: int,
    noise_mm: float,
    per_count_mm: float,
    slowest_period: float,
    unseen_swing: float,
) -> Chain:
    """Return the filter of a model as the daemon runs it; arguments as those of `Chain`, `per_count_mm` its step."""
    mean = Mean(chosen.kind, chosen.window, chosen.max_readings, chosen.spike_mm)
    return Chain(mean, channels, noise_mm, slowest_period, per_count_mm, unseen_swing)


def check_errors(scene: Scene, errors: ReadingErrors, chosen: FilterChoice, deflection_mm: float) -> None:
    """Raise SceneError as `check_scale`, or if the zeros of a scene's sensors drift too far for any model.

    `errors` are those of the scene, `chosen` is the filter and `deflection_mm` the largest deflection.
    """
    check_scale(errors.behind(chosen).sample_mm, deflection_mm, scene.unit)
    if max(errors.zero_mm, errors.warmth_mm) > MAX_NOISE * deflection_mm:
        setting = f"zero_drift_mm = {digits(errors.zero_mm, 3)}"
        if errors.warmth_mm > errors.zero_mm:
            setting = f"drift_um_per_k = {scene.sensors.drift_um_per_k:g}"
        raise SceneError(
            f"sensors.{setting} hides the largest deflection, {digits(deflection_mm, 3)} {scene.unit}; "
            "tare more often, use better sensors or a softer beam"
        )


def check_scale(noise_mm: float, max_deflection_mm: float, unit: str = MM) -> None:
    """Raise SceneError if no model can carry the deflection, or the noise next to it; both are in `unit`.

    A noise of 0 passes; the caller decides whether it will do.
    """
    if not MIN_DEFLECTION_MM <= max_deflection_mm <= MAX_DEFLECTION_MM:
        raise SceneError(
            f"the largest deflection is {digits(max_deflection_mm, 3)} {unit}, which no sensor measures; check the "
            "length and the rigidity of a beam, the table of a measured structure, and contact.force_n"
        )
    if noise_mm > MAX_NOISE * max_deflection_mm:
        raise SceneError(
            f"sensors: a sample's noise of {digits(noise_mm, 3)} {unit} hides the largest deflection, "
            f"{digits(max_deflection_mm, 3)} {unit}; use better sensors or a softer beam"
        )
    if 0 < noise_mm < MIN_NOISE * max_deflection_mm:
        raise SceneError(
            f"sensors: a sample's noise of {digits(noise_mm, 3)} {unit} is less than 1e-4 % of the largest deflection, "
            f"{digits(max_deflection_mm, 3)} {unit}, too little for the float32 of a model; state the noise of a real "
            "sensor"
        )
