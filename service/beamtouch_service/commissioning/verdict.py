"""The verdict of a commissioning: findings of sensors and errors of places, in words with what to do. Pure."""

from collections.abc import Mapping, Sequence
from math import isnan
from typing import NamedTuple

from beamtouch_common.outline import BEAM_AXIS
from beamtouch_service.commissioning.report import Finding, PlaceResult
from beamtouch_service.commissioning.wiring import Explanation, Wiring
from beamtouch_service.samples import Quality

DEAD = 0.2
"""A channel that moves by more than this is not dead."""
PRESS_MM = 5.0
"""Distance from a mark at which a person may press."""
ALIKE = 0.5
"""Errors of position are alike if they differ by at most this part of their mean: then the marks count otherwise."""
GAINS = (0.8, 1.25)
"""Movement of a channel over what it should be, relative to the others, that is as it should."""
_DIGITS = 4
UNSEEN = "the press was not seen"
_INVERTED = "moves the wrong way"
_RIGHT = "moves as it should"
_DEAD = "does not move"


class SensorFinding(NamedTuple):
    """Findings of the presses on one sensor."""

    finding: Finding
    says: str


def judge_sensors(explanation: Explanation, names: Sequence[str], bad: Mapping[str, Quality]) -> list[SensorFinding]:
    """Return what presses show of each channel; `bad` are the channels that are not good."""
    findings = []
    for channel, name in enumerate(names):
        rivals = list(dict.fromkeys(_of(rival, channel, names) for rival in explanation.rivals))
        best = _of(explanation.wiring, channel, names)
        others = [rival.says for rival in rivals if rival != best]
        share = float(explanation.shares[channel])
        if isnan(share):
            findings.append(SensorFinding(Finding.UNSURE, "the presses hardly move it: nothing can be said"))
        elif not explanation.is_explained:
            says = f"no wiring explains the presses; it moves {100 * share:.0f} % as far as it should"
            findings.append(SensorFinding(Finding.UNSURE, says))
        elif best.finding is Finding.DEAD and abs(share) > DEAD:
            findings.append(SensorFinding(Finding.GAIN, f"hardly moves: {100 * share:.0f} % as far as it should"))
        elif best.finding is not Finding.DEAD and _is_off(share):
            findings.append(SensorFinding(Finding.GAIN, f"{best.says}, but {100 * abs(share):.0f} % as far"))
        elif others:
            findings.append(SensorFinding(Finding.UNSURE, f"not sure: {best.says}, or {others[0]}"))
        elif best.finding is Finding.DEAD and name in bad:
            findings.append(SensorFinding(Finding.DEAD, f"{best.says} ({bad[name].value})"))
        else:
            findings.append(best)
    return findings


def _is_off(share: float) -> bool:
    """Return whether a channel moves too little or too much; False where nothing can be said."""
    low, high = GAINS
    return not (isnan(share) or low <= abs(share) <= high)


def _of(wiring: Wiring, channel: int, names: Sequence[str]) -> SensorFinding:
    """Return what a wiring says of one channel."""
    sensor, sign = wiring.sensors[channel], wiring.signs[channel]
    if sign == 0:
        return SensorFinding(Finding.DEAD, _DEAD)
    if sensor != channel:
        way = ", the wrong way" if sign < 0 else ""
        return SensorFinding(Finding.SWAPPED, f"moves as {names[sensor]} should{way}")
    return SensorFinding(Finding.INVERTED, _INVERTED) if sign < 0 else SensorFinding(Finding.RIGHT, _RIGHT)


def advise_unseen(names: Sequence[str], kind: str) -> list[str]:
    """Return a sentence on the sensors of which no press was seen, on a beam or a plate, as `kind` says."""
    if not names:
        return []
    return [
        f"The press above {_listed(names)} was not seen. If you did press firmly, check that the daemon reads this "
        f"surface, and that the {kind} bends there."
    ]


def advise(explanation: Explanation, names: Sequence[str], findings: Sequence[SensorFinding], kind: str) -> list[str]:
    """Return a sentence for each fault of the wiring, with what to do; `kind`: beam or plate."""
    wiring, sentences = explanation.wiring, list[str]()
    by_name = dict(zip(names, findings, strict=True))
    if not explanation.is_explained:
        off = [name for name, share in zip(names, explanation.shares.tolist(), strict=True) if _is_off(share)]
        look = f" Look first at {_listed(off)}: the movement is not in proportion to the others." if off else ""
        return [
            "No wiring explains the presses. Check that each press was above its sensor, that nothing else touched the "
            f"{kind}, and that the model is that of this {kind}.{look}"
        ]
    unsure = [name for name, one in by_name.items() if one.finding is Finding.UNSURE]
    if unsure:
        each = "; ".join(f"{name}: {by_name[name].says.removeprefix('not sure: ')}" for name in unsure)
        sentences.append(f"Not sure about {_listed(unsure)} ({each}). Press more firmly, exactly above each sensor.")
    sentences += _of_cables(wiring, names, set(unsure))
    inverted = [
        name
        for name, one, sign in zip(names, findings, wiring.signs, strict=True)
        if one.finding is not Finding.UNSURE and sign < 0
    ]
    if inverted:
        verb = "moves" if len(inverted) == 1 else "move"
        sentences.append(
            f"{_listed(inverted)} {verb} the wrong way. Measure the characteristic with two feeler gauges, and correct "
            "gain_mm_per_count and offset_mm of the channel."
        )
    for name, share in zip(names, explanation.shares.tolist(), strict=True):
        if by_name[name].finding is Finding.GAIN:
            sentences.append(
                f"{name} moves {100 * abs(share):.0f} % as far as it should, next to the others. Check its gap and its "
                "characteristic."
            )
    for name, one in by_name.items():
        if one.finding is Finding.DEAD:
            sentences.append(f"{name} {one.says}. Check its cable, its supply, its input and its gap.")
    return sentences


def _of_cables(wiring: Wiring, names: Sequence[str], unsure: set[str]) -> list[str]:
    moved = {channel: sensor for channel, sensor in wiring.moved.items() if names[channel] not in unsure}
    if not moved:
        return []
    pairs = [(one, other) for one, other in moved.items() if one < other and moved.get(other) == one]
    is_reversed = len(names) > 3 and wiring.sensors == tuple(range(len(names)))[::-1]
    if is_reversed:
        return [
            "The channels are in reverse order. Check from which end the sensors are numbered, and the order in the "
            "daemon's configuration."
        ]
    sentences = [f"The cables of {names[one]} and {names[other]} are swapped. Swap them back." for one, other in pairs]
    paired = {channel for pair in pairs for channel in pair}
    mixed = [f"{names[one]} has the sensor {names[other]}" for one, other in moved.items() if one not in paired]
    if mixed:
        sentences.append(f"Cables are mixed up: the input of {', that of '.join(mixed)}.")
    return sentences


def judge_place(place: PlaceResult, reason: str = "") -> PlaceResult:
    """Return a place with its error, and the result in words; `reason`: why the surface had no state."""
    if place.state is None:
        return place.model_copy(update={"says": reason})
    if place.stated_mm is None:
        return place.model_copy(update={"says": f"no position: {place.state.value}"})
    error_mm, allowed_mm, says = dict[str, float](), dict[str, float](), list[str]()
    for axis, (stated_mm, low_mm, high_mm) in place.stated_mm.items():
        error_mm[axis] = round(stated_mm - place.at_mm[axis], _DIGITS)
        allowed_mm[axis] = round(PRESS_MM + (high_mm - low_mm) / 2, _DIGITS)
        word = "within" if abs(error_mm[axis]) <= allowed_mm[axis] else "more than"
        says.append(f"{_named(axis)}{error_mm[axis]:+.1f} mm, {word} {allowed_mm[axis]:.1f} mm")
    return place.model_copy(update={"error_mm": error_mm, "allowed_mm": allowed_mm, "says": "; ".join(says)})


def is_right(place: PlaceResult) -> bool:
    """Return whether the place that was stated is that of the mark, along each axis."""
    return place.error_mm is not None and all(_is_right(place, axis) for axis in place.error_mm)


def _is_right(place: PlaceResult, axis: str) -> bool:
    errors_mm, allowed_mm = place.error_mm or {}, place.allowed_mm or {}
    return abs(errors_mm[axis]) <= allowed_mm[axis]


def _named(axis: str) -> str:
    """Return the name of an axis in front of a figure; a beam has only one."""
    return "" if axis == BEAM_AXIS else f"{axis} "


def advise_places(places: Sequence[PlaceResult], *, is_wired: bool) -> list[str]:
    """Return sentences on the marked places; `is_wired`: whether every sensor moves as it should."""
    sentences = [
        f"At {', '.join(f'{at_mm:g}' for at_mm in place.at_mm.values())} mm: {place.says}."
        for place in places
        if place.error_mm is None
    ]
    stated = [place for place in places if place.error_mm is not None]
    errors_mm = dict[str, list[float]]()
    for place in stated:
        for axis, error_mm in (place.error_mm or {}).items():
            errors_mm.setdefault(axis, []).append(error_mm)
    if errors_mm:
        largest_mm = max(abs(error_mm) for errors in errors_mm.values() for error_mm in errors)
        sentences.append(f"The largest error of a position is {largest_mm:.1f} mm.")
    if not is_wired:
        return [*sentences, "Positions mean little until every sensor moves as it should. Put that right, and repeat."]
    if all(map(is_right, stated)):
        return sentences
    wrong = [axis for axis in errors_mm if not all(_is_right(place, axis) for place in stated)]
    advice = [_advise_shift(axis, errors_mm[axis]) for axis in wrong]
    if not all(advice):
        advice = ["This is more than aim explains. Repeat the commissioning; if it stays so, calibrate the model."]
    return [*sentences, *advice]


def _advise_shift(axis: str, errors_mm: Sequence[float]) -> str:
    """Return a sentence on errors along an axis that are alike at all marks; empty if they are not."""
    mean_mm = sum(errors_mm) / len(errors_mm)
    if len(errors_mm) < 2 or max(errors_mm) - min(errors_mm) > ALIKE * abs(mean_mm):
        return ""
    what, way = "positions" if axis == BEAM_AXIS else f"figures of {axis}", "large" if mean_mm > 0 else "small"
    return f"All {what} are about {abs(mean_mm):.0f} mm too {way}: the marks may count from another point."


def _listed(names: Sequence[str]) -> str:
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)
