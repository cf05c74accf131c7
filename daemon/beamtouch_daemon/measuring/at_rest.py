"""Checks that nothing touches the beam, for `tare`, `record` and `noise`. Pure.

A load moves the beam when it comes, and holds it away from its rest gaps while it stays.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from beamtouch_common.digits import digits
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.measuring.tares import DRIFTS_WITHIN, find_contradictions, largest_change_mm
from beamtouch_daemon.processing import resolution, stuck
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_models.filters import FloatArray
from beamtouch_service.samples import Quality

TARE_S = 1.0
MIN_TARE_READINGS = 50
"""A tare averages the longer of this time and this number of readings; below it, noise looks like motion too often."""
MAX_SPREAD = 2.0
"""Largest standard deviation at rest, relative to the noise of one reading."""
MAX_DRIFT = 1.0
"""Largest difference between the means of both halves, relative to the noise of one reading."""
DRIFT_DEVIATIONS = 5.0
"""The same difference, relative to its own standard deviation; the smaller of both limits counts."""
MAX_BAD = 0.01
"""Largest share of the readings of a recording in which a channel is not good."""
FEW_VALUES = 4
"""A channel whose counts never change is stuck if another takes more values than this: a coarse ADC gives no more."""
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
CHANCE = 3.0
"""Correlations up to this, over the root of the number of such stretches, may be chance, however slow the noise is."""


class NotAtRestError(Exception):
    """The beam is not at rest, or a sensor does not work; the text is one line for the user."""


def readings_for_tare(rate_hz: float) -> int:
    """Return the number of readings that a tare averages."""
    return max(MIN_TARE_READINGS, math.ceil(TARE_S * rate_hz))


def rest_gaps(counts: FloatArray, surface: Surface) -> dict[str, float]:
    """Return the mean gap of each channel [mm], by name, of counts of shape (readings, channels), NaN where missing.

    Without `noise_mm`, the noise is estimated from the differences between successive readings, which a slow motion
    hardly changes.

    Raises
    ------
    NotAtRestError
        A channel was not always good, or the surface moved: its spread or drift exceeds what noise and one step
        explain.
    """
    characteristic = Characteristic.of(surface)
    _require_good(characteristic.quality(counts), surface.channel_names, max_share=0.0)
    gaps = characteristic.gap(counts)
    for name, gap, step_mm in zip(surface.channel_names, gaps.T, steps_mm(counts, surface).tolist(), strict=True):
        if moved := describe_motion(gap, step_mm, surface):
            raise NotAtRestError(f"{name} moved: {moved}; take everything off the beam and try again")
    return dict(zip(surface.channel_names, np.mean(gaps, axis=0).tolist(), strict=True))


def steps_mm(counts: FloatArray, surface: Surface) -> FloatArray:
    """Return the step of each channel [mm], shape (channels,), as counts at rest (readings, channels) show it.

    A beam that moves once shows a large step, too. So a step that is larger than its type says counts up to the
    difference that a rest gap may have from the last tare anyway.
    """
    of_type, shown = resolution.finest(surface), resolution.steps_shown(counts, surface)
    harmless_mm = [largest_change_mm(channel, DRIFTS_WITHIN) for channel in surface.channels]
    count_mm = Characteristic.of(surface).steepest
    return np.maximum(of_type * count_mm, np.where(np.isfinite(shown), np.minimum(shown * count_mm, harmless_mm), 0.0))


def noise_of(gap_mm: FloatArray, noise_mm: float | None) -> float:
    """Return the noise of a reading [mm]: `noise_mm`, or estimated from differences between successive readings."""
    return float(np.std(np.diff(gap_mm))) / math.sqrt(2.0) if noise_mm is None else noise_mm


def describe_motion(gap_mm: FloatArray, step_mm: float, surface: Surface) -> str:
    """Describe the motion in the gaps of a channel, shape (readings,); empty if noise and one ADC step explain it."""
    noise, unit = noise_of(gap_mm, surface.noise_mm), surface.value_unit
    spread = float(np.std(gap_mm))
    first, second = np.array_split(gap_mm, 2)
    drift = abs(float(np.mean(second) - np.mean(first)))
    # The difference of two means of n / 2 readings has 2 / sqrt(n) times the standard deviation of a reading.
    max_drift = min(MAX_DRIFT, DRIFT_DEVIATIONS * 2 / math.sqrt(len(gap_mm))) * noise
    if spread <= MAX_SPREAD * noise + step_mm and drift <= max_drift + step_mm:
        return ""
    sizes = (("standard deviation", spread), ("drift", drift), ("noise", noise))
    return ", ".join(f"{name} {digits(size, 2)} {unit}" for name, size in sizes)


def select_rest(counts: FloatArray, surface: Surface, last_mm: Mapping[str, float]) -> FloatArray:
    """Return the readings of a long recording in which all channels are good. It does not trust the stated noise.

    Parameters
    ----------
    counts : Shape (readings, channels), NaN where missing.
    surface : The configuration.
    last_mm : Rest gaps of the last tare [mm], by channel name; empty without one.

    Raises
    ------
    NotAtRestError
        A channel is not good or stuck, or the beam is touched, moves or drifts.
    """
    characteristic, names = Characteristic.of(surface), surface.channel_names
    good = _require_good(characteristic.quality(counts), names, MAX_BAD)
    counts = counts[good.all(axis=1)]
    if frozen := find_frozen(counts, surface):
        raise NotAtRestError(stuck_complaint(frozen))
    still = np.array(surface.has_fractions) & ~np.isfinite(resolution.steps_shown(counts, surface))
    if names_of_still := [name for name, is_still in zip(names, still.tolist(), strict=True) if is_still]:
        message = f"{', '.join(names_of_still)}: neither noise nor steps show, as the counts do not change; "
        raise NotAtRestError(f"{message}state noise_mm from the data sheet, with half a step at least")
    gaps = characteristic.gap(counts)
    # Of an hour, the first minute: what zeros do after it is to be measured.
    rest = dict(zip(names, gaps[: math.ceil(60 * surface.rate_hz)].mean(axis=0).tolist(), strict=True))
    if contradictions := find_contradictions(rest, last_mm, surface):
        message = (
            f"{', '.join(contradictions)}; take everything off the beam, or tare it again if its sensors were moved"
        )
        raise NotAtRestError(message)
    if moved := _find_jump(gaps, steps_mm(counts, surface), surface) or _find_vibration(gaps, surface):
        raise NotAtRestError(f"{moved}; take everything off the beam, leave it alone and try again")
    return counts


def without_line(values: FloatArray) -> FloatArray:
    """Return values, shape (readings, channels), without their mean and their straight trend."""
    time = np.arange(len(values)) - (len(values) - 1) / 2
    centred = values - values.mean(axis=0)
    residual: FloatArray = centred - time[:, np.newaxis] * (time @ centred / (time @ time))
    return residual


def _require_good(codes: NDArray[np.int8], channels: Sequence[str], max_share: float) -> NDArray[np.bool_]:
    """Return where channels are good, shape (readings, channels); NotAtRestError if one is not in too many readings."""
    good: NDArray[np.bool_] = codes == QUALITIES.index(Quality.GOOD)
    bad = [
        f"{name} is {QUALITIES[int(wrong[0])]} in {len(wrong)} of {len(codes)} readings"
        for name, wrong in zip(channels, (column[column != 0] for column in codes.T), strict=True)
        if len(wrong) > max_share * len(codes)
    ]
    if bad:
        raise NotAtRestError(f"{', '.join(bad)}; check the sensor")
    return good


def find_frozen(counts: FloatArray, surface: Surface) -> list[str]:
    """Return the names of channels that never change, where the stated noise or the other channels would show.

    A stated `stuck_after_ms` says more than either. `counts` has the shape (readings, channels).
    """
    values = np.array([1 + len(changes) for changes in resolution.changes_shown(counts, surface)])
    longest = stuck.longest_runs(surface)
    is_stated = np.array([channel.stuck_after_ms is not None for channel in surface.channels])
    changes = np.isfinite(longest) | surface.has_fractions | (values.max() > FEW_VALUES)
    is_frozen = (values == 1) & np.where(is_stated, len(counts) > longest, changes)
    return [name for name, frozen in zip(surface.channel_names, is_frozen.tolist(), strict=True) if frozen]


def stuck_complaint(channels: Sequence[str]) -> str:
    """Return one line for the user about channels whose counts do not change."""
    return (
        f"{', '.join(channels)} stuck: the counts do not change; check the sensor, or state stuck_after_ms if it works"
    )


def _find_jump(gaps: FloatArray, step_mm: FloatArray, surface: Surface) -> str:
    """Describe a sudden change, or a drift that is too fast, in gaps (readings, channels); empty if there is none."""
    minutes = max(1.0, len(gaps) / (60 * surface.rate_hz))
    residual = without_line(gaps)
    medians = np.median(np.stack([residual[:-2], residual[1:-1], residual[2:]]), axis=0)  # without single spikes
    fifths = gaps[: len(gaps) // 5 * 5].reshape(5, -1, gaps.shape[1]).mean(axis=1)
    for index, channel in enumerate(surface.channels):
        width = max(JUMP_READINGS, round(JUMP_S * surface.rate_hz))
        if jump := _largest_jump(medians[:, index], width, float(step_mm[index])):
            place, size_mm = jump
            moved, after_s = digits(size_mm, 2), digits(place / surface.rate_hz, 3)
            return f"{channel.name} moved by {moved} {surface.value_unit} after {after_s} s"
        drift_mm = float(np.ptp(fifths[:, index]))
        if drift_mm > minutes * DRIFTS_WITHIN * (channel.range_mm[1] - channel.range_mm[0]):
            return f"{channel.name} drifted by {digits(drift_mm, 2)} {surface.value_unit}"
    return ""


def _largest_jump(values: FloatArray, width: int, step: float) -> tuple[int, float] | None:
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


def _find_vibration(gaps: FloatArray, surface: Surface) -> str:
    """Describe the two channels that scatter most alike; empty if that may be chance, or if only one varies."""
    width = max(VIBRATION_READINGS, round(VIBRATION_S * surface.rate_hz))
    blocks = without_line(gaps)[: len(gaps) // width * width].reshape(-1, width, gaps.shape[1])
    fast = (blocks - blocks.mean(axis=1, keepdims=True)).reshape(-1, gaps.shape[1])
    varying = np.flatnonzero(fast.any(axis=0))
    if len(varying) < 2:
        return ""
    fast = fast[:, varying]
    alike = np.abs(np.corrcoef(fast.T))
    np.fill_diagonal(alike, 0.0)
    first, second = np.unravel_index(int(alike.argmax()), alike.shape)
    if alike[first, second] <= max(MAX_TOGETHER, CHANCE / math.sqrt(len(blocks))):
        return ""
    names = [surface.channel_names[int(varying[place])] for place in (first, second)]
    return f"{' and '.join(names)} move together (correlation {alike[first, second]:.2f}), so the beam moves"
