"""Compares rest gaps with the last tare, or the configuration: a load, warmth, swapped cables, a new sensor. Pure."""

import math
from collections.abc import Mapping

import numpy as np

from beamtouch_common.digits import decimals_of, digits
from beamtouch_daemon.config.settings import Surface
from beamtouch_daemon.config.signal import Channel
from beamtouch_daemon.processing.filters import walk_of

MOUNTED_WITHIN = 0.1
"""Largest difference from the configured rest gap, which may be nominal, as a part of the linear range."""
DRIFTS_WITHIN = 0.02
"""Largest difference between two tares, from warmth and settling, as a part of the linear range; also the largest drift
in each minute of a long recording."""
LOAD_SHARE = 0.1
"""The same for both, as a part of what the smallest force causes where it moves the channel most. Smaller parts would
refuse ordinary settling. With it, the smallest force shows everywhere but within a few percent of the supports."""
FEWEST_WARM = 3
"""Fewest channels whose common difference may be warmth: a load between two moves both alike."""
ALIKE = 0.3
"""Largest difference of a channel from the median of all, as a part of that, if all have moved about alike."""
STATED_DEVIATIONS = 4.0
"""A difference within this many standard deviations of the stated drift is never refused."""


def find_contradictions(
    rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface, since_s: float = math.inf
) -> list[str]:
    """Return a phrase for each channel whose rest gap differs too much from the last tare, or the configuration.

    Parameters
    ----------
    rest_gap_mm : Measured rest gaps [mm], by channel name.
    last_mm : Rest gaps of the last tare [mm], by channel name; empty without one: then the configuration counts.
    surface : The configuration.
    since_s : Time since the last tare [s], which bounds warmth; infinite if it is not known.
    """
    reference = "the last tare" if last_mm else "its rest_gap_mm"
    differences = _differences(rest_gap_mm, last_mm, surface, _warmth_mm(rest_gap_mm, last_mm, surface, since_s))
    contradictions = [
        f"{name} {difference_mm:+.{max(3, decimals_of(allowed_mm))}f} {surface.value_unit} from {reference}"
        for name, difference_mm, allowed_mm in differences
        if abs(difference_mm) > allowed_mm
    ]
    swap = _find_swap(rest_gap_mm, last_mm, surface) if len(contradictions) == 2 else ""
    return [*contradictions, swap] if swap else contradictions


def find_moved(
    rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface, since_s: float = math.inf
) -> list[str]:
    """Return the channels that have moved by themselves since the last tare, as a sensor does that is replaced."""
    if not last_mm or common_mm(rest_gap_mm, last_mm, surface):
        return []
    differences = _differences(rest_gap_mm, last_mm, surface, _warmth_mm(rest_gap_mm, last_mm, surface, since_s))
    return [name for name, difference_mm, allowed_mm in differences if abs(difference_mm) > allowed_mm]


def common_mm(rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface) -> float:
    """Return by how much all gaps have changed since the last tare if they have done so about alike, as in warmth.

    0 if they have not, or if there are too few to tell warmth from a load.
    """
    if not last_mm or len(surface.channels) < FEWEST_WARM:
        return 0.0
    moved_mm = np.array([difference_mm for _, difference_mm, _ in _differences(rest_gap_mm, last_mm, surface, 0.0)])
    median_mm = float(np.median(moved_mm))
    beside = _differences(rest_gap_mm, last_mm, surface, median_mm)
    is_alike = all(abs(apart_mm) <= max(allowed_mm, ALIKE * abs(median_mm)) for _, apart_mm, allowed_mm in beside)
    return median_mm if is_alike and len(set(np.sign(moved_mm).tolist())) == 1 else 0.0


def _find_swap(rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface) -> str:
    """Return a phrase for two channels that have each other's rest gaps; empty if none have.

    They are the ones that differ from their own.
    """
    before_mm = {channel.name: last_mm.get(channel.name, channel.rest_gap_mm) for channel in surface.channels}
    differences = _differences(rest_gap_mm, last_mm, surface, 0.0)
    first, second = sorted(differences, key=lambda difference: abs(difference[1]) - difference[2])[-2:]
    apart_mm = before_mm[first[0]] - before_mm[second[0]]
    is_swapped = abs(first[1] + apart_mm) <= first[2] and abs(second[1] - apart_mm) <= second[2]
    names = " and ".join(sorted((first[0], second[0])))
    return f"{names} have each other's rest gaps, so their cables seem to be swapped" if is_swapped else ""


def describe_comparison(
    rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface, since_s: float = math.inf
) -> str:
    """Describe what accepted rest gaps were compared with, and how closely; arguments as `find_contradictions`."""
    warmth_mm = _warmth_mm(rest_gap_mm, last_mm, surface, since_s)
    differences = _differences(rest_gap_mm, last_mm, surface, warmth_mm)
    name, difference_mm, _ = max(differences, key=lambda difference: abs(difference[1]))
    smallest_mm = min(allowed_mm for _, _, allowed_mm in differences)
    what = "compared with the last tare" if last_mm else "first tare, compared with rest_gap_mm"
    unit = surface.value_unit
    differs, allowed = (f"{digits(size_mm, 2)} {unit}" for size_mm in (abs(difference_mm), smallest_mm))
    text = f"{what}: {name} differs most, by {differs}; {allowed} are allowed"
    if abs(warmth_mm) > smallest_mm:
        text += (
            f"; all gaps changed by about {warmth_mm:+.{max(3, decimals_of(smallest_mm))}f} {unit}, taken for warmth: "
            "a load that moves all sensors about alike would pass, too, so look at the beam"
        )
    if all(channel.smallest_force_mm is None for channel in surface.channels):
        return f"{text}; a load that moves less is not noticed, as the channels state no smallest_force_mm"
    return text


def _warmth_mm(
    rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface, since_s: float
) -> float:
    """Return what all channels have in common [mm], as far as zeros drift in the time since the last tare [s].

    No load moves all alike. Few channels show no difference between the two.
    """
    walk = walk_of(surface)
    if walk is None or not last_mm or len(surface.channels) < FEWEST_WARM:
        return 0.0
    moved_mm = [
        rest_gap_mm[channel.name] - last_mm.get(channel.name, channel.rest_gap_mm) for channel in surface.channels
    ]
    most_mm = min(walk.max_mm, STATED_DEVIATIONS * float(walk.grown_mm(since_s)))
    return min(max(float(np.median(moved_mm)), -most_mm), most_mm)


def _differences(
    rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface, warmth_mm: float
) -> list[tuple[str, float, float]]:
    """Return name, difference [mm] beyond the warmth, and largest allowed difference [mm] of each channel."""
    moved_mm = {
        channel.name: rest_gap_mm[channel.name] - last_mm.get(channel.name, channel.rest_gap_mm)
        for channel in surface.channels
    }
    drift_mm = STATED_DEVIATIONS * surface.zero_drift_mm
    differences = []
    for channel in surface.channels:
        largest_mm = largest_change_mm(channel, DRIFTS_WITHIN if last_mm else MOUNTED_WITHIN)
        allowed_mm = max(largest_mm, drift_mm) + (surface.noise_mm or 0.0)
        differences.append((channel.name, moved_mm[channel.name] - warmth_mm, allowed_mm))
    return differences


def largest_change_mm(channel: Channel, share: float) -> float:
    """Return a share of the linear range [mm], or of what the smallest force causes if that is less."""
    largest_mm = share * (channel.range_mm[1] - channel.range_mm[0])
    if channel.smallest_force_mm is None:
        return largest_mm
    return min(largest_mm, LOAD_SHARE * channel.smallest_force_mm)
