"""Checks that a recording is of a beam at rest with working sensors. They do not trust the configured noise."""

from collections.abc import Mapping

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_daemon.config.places import encoding_of
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.processing import stuck, tare
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.correlations import summed_correlations, without_line
from beamtouch_daemon.processing.rest_noise import readings_needed
from beamtouch_models.filters import FloatArray
from beamtouch_service.samples import Quality

MAX_BAD = 0.01
"""Largest share of readings in which a channel is not good."""
STILL_SHARE = 0.2
FEW_VALUES = 4
"""A channel is stuck if its counts do not change over this share of the recording, while it or another channel takes
more values than an ADC that is coarser than the noise gives."""
JUMP_S = 0.1
JUMP_READINGS = 4
"""Means over the longer of this time and this number of readings show whether the beam is touched."""
LONGER = 4
MIN_MEANS = 30
"""Factor between the lengths of means, of which longer ones show lighter touches, and the fewest means of a length."""
MAX_JUMP = 8.0
"""Largest change between two adjacent means, wherever they meet, relative to their usual change; noise does not reach
it in a year."""
VIBRATION_S = 0.5
VIBRATION_READINGS = 20
"""Vibrations are sought within the longer of this time and this number of readings; slower changes are drift."""
MAX_TOGETHER = 0.5
"""Largest correlation between two channels; beyond it, more than half of their scatter has one cause."""
CHANCE_DEVIATIONS = 5.0
"""Correlations below this number of standard deviations may be chance."""


class NotMeasuredError(Exception):
    """The recording does not show the noise at rest; the text is one line for the user."""


def at_rest(counts: FloatArray, surface: Surface, last_mm: Mapping[str, float]) -> FloatArray:
    """Return the readings in which all channels are good.

    Parameters
    ----------
    counts
        Shape (readings, channels), NaN where missing.
    surface
        The configuration.
    last_mm
        Rest gaps of the last tare [mm], by channel name; empty without one.

    Raises
    ------
    NotMeasuredError
        There are too few readings, a channel is not good or stuck, or the beam is touched, moves or drifts.
    """
    if len(counts) < (needed := readings_needed(surface)):
        message = f"{len(counts)} readings arrived and its filter needs {needed}; give a longer --seconds"
        raise NotMeasuredError(message)
    characteristic = Characteristic.of(surface.channels)
    codes = characteristic.quality(counts)
    good = QUALITIES.index(Quality.GOOD)
    bad = []
    for name, column in zip(surface.channel_names, codes.T, strict=True):
        wrong = column[column != good]
        if len(wrong) > MAX_BAD * len(column):
            bad.append(f"{name} is {QUALITIES[int(wrong[0])]} in {len(wrong)} of {len(column)} readings")
    if bad:
        message = f"{', '.join(bad)}; check the sensor"
        raise NotMeasuredError(message)
    counts = counts[(codes == good).all(axis=1)]
    if frozen := _stuck(counts, surface):
        message = f"{', '.join(frozen)} stuck: the counts do not change; check the sensor"
        raise NotMeasuredError(message)
    gaps = characteristic.gap(counts)
    rest = dict(zip(surface.channel_names, gaps.mean(axis=0).tolist(), strict=True))
    if found := tare.contradictions(rest, last_mm, surface):
        message = f"{', '.join(found)}; take everything off the beam, or tare it again if its sensors were moved"
        raise NotMeasuredError(message)
    if moved := _motion(gaps, surface):
        message = f"{moved}; take everything off the beam, leave it alone and try again"
        raise NotMeasuredError(message)
    return counts


def _stuck(counts: FloatArray, surface: Surface) -> list[str]:
    """Return the names of the channels that are stuck."""
    lengths, _ = stuck.runs(counts, stuck.fresh(counts.shape[1]))
    still = lengths.max(axis=0) > STILL_SHARE * len(counts)
    values = [len(np.unique(column)) for column in counts.T]
    steepest = Characteristic.of(surface.channels).steepest
    longest = stuck.longest_runs(surface.channels, steepest, surface.noise_mm, surface.rate_hz)
    fractional = np.array([encoding_of(surface.source, channel) == "f32" for channel in surface.channels])
    never = np.array(values) == 1
    frozen = still & (fractional | (max(values) > FEW_VALUES)) | never & np.isfinite(longest)
    return [name for name, is_frozen in zip(surface.channel_names, frozen.tolist(), strict=True) if is_frozen]


def _motion(gaps: FloatArray, surface: Surface) -> str:
    """Describe a motion in gaps of shape (readings, channels); empty if there is none."""
    steps = Characteristic.of(surface.channels).steepest
    residual = without_line(gaps)
    together = _together(residual, surface)
    for index, (name, channel) in enumerate(zip(surface.channel_names, surface.channels, strict=True)):
        width = max(JUMP_READINGS, round(JUMP_S * surface.rate_hz))
        if jump := _jump(_without_spikes(residual[:, index]), width, float(steps[index])):
            at, size_mm = jump
            return f"{name} moved by {digits(size_mm, 2)} mm after {digits(at / surface.rate_hz, 3)} s"
        slow = _means(gaps[:, index], len(gaps) // 5)
        if (drift := float(np.ptp(slow))) > tare.DRIFTS_WITHIN * (channel.range_mm[1] - channel.range_mm[0]):
            return f"{name} drifted by {digits(drift, 2)} mm"
    return together


def _together(residual: FloatArray, surface: Surface) -> str:
    """Describe the channels that scatter most alike; empty if they do not, or there is only one."""
    width = max(VIBRATION_READINGS, round(VIBRATION_S * surface.rate_hz))
    blocks = residual[: len(residual) // width * width].reshape(-1, width, residual.shape[1])
    summed, own = summed_correlations(blocks)
    fast = (blocks - blocks.mean(axis=1, keepdims=True)).reshape(-1, residual.shape[1])
    varying = np.flatnonzero(own > 0)
    if len(varying) < 2:
        return ""
    independent = len(fast) * float(np.min(own[varying] / np.maximum(summed[varying], own[varying])))
    alike = np.abs(np.corrcoef(fast[:, varying].T))
    np.fill_diagonal(alike, 0.0)
    first, second = np.unravel_index(int(alike.argmax()), alike.shape)
    if alike[first, second] <= max(MAX_TOGETHER, CHANCE_DEVIATIONS / np.sqrt(independent)):
        return ""
    one, other = (surface.channel_names[int(varying[at])] for at in (first, second))
    return f"{one} and {other} move together (correlation {alike[first, second]:.2f}), so the beam moves"


def _jump(values: FloatArray, width: int, step: float) -> tuple[int, float] | None:
    """Return place and size of the largest change of values (readings,) beyond noise; None if there is none."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    longest = max(width, len(values) // MIN_MEANS)
    while width <= longest:
        change = np.abs(total[2 * width :] - 2 * total[width:-width] + total[: -2 * width]) / width
        usual = float(np.median(change)) / 0.6745  # of Gaussian changes, half are smaller than 0.6745 deviations
        if (largest := float(change.max())) > MAX_JUMP * usual + step:
            return int(change.argmax()) + width, largest
        width *= LONGER
    return None


def _means(values: FloatArray, width: int) -> FloatArray:
    means: FloatArray = values[: len(values) // width * width].reshape(-1, width).mean(axis=1)
    return means


def _without_spikes(values: FloatArray) -> FloatArray:
    """Return the medians of three successive values."""
    medians: FloatArray = np.median(np.stack([values[:-2], values[1:-1], values[2:]]), axis=0)
    return medians
