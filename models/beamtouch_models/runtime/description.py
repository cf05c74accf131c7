"""A model file in words, for every command that describes one."""

import math
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from beamtouch_common.digits import digits
from beamtouch_models.numbers import three_digits
from beamtouch_models.runtime.metadata import POSITION_OUTPUTS, Metadata

NARROW = 0.015
"""Share of the range of contacts that a stretch at one of its ends must exceed to be told."""


def summary(metadata: Metadata, identity: str, outputs: Sequence[str]) -> str:
    """Return the metadata as text, each number with its unit and reference."""
    accuracy, noise, chosen, sensor = metadata.accuracy, metadata.noise, metadata.filter, metadata.sensor
    layout = ", ".join(f"{channel.name} {channel.position_mm:g}" for channel in metadata.layout)
    low, high = metadata.ranges.position_mm
    weak, strong = metadata.ranges.force_n
    force = f"{weak:g} N, known" if weak == strong else f"{weak:g}..{strong:g} N, not known in advance"
    gap = f"gap {sensor.range_mm[0]:g}..{sensor.range_mm[1]:g} mm, {digits(sensor.standoff_mm, 4)} mm at rest"
    most = "" if chosen.max_readings == chosen.window else f" to {chosen.max_readings}"
    smoothing = f"{chosen.kind} of {chosen.window}{most} readings"
    error = f"{three_digits(accuracy.error_percent)} % +- {digits(accuracy.error_standard_error, 1)}"
    best = f"{three_digits(accuracy.limit_percent)} % +- {digits(accuracy.limit_standard_error, 1)}"
    ratio = f"{accuracy.ratio:.3f} +- {digits(accuracy.ratio_standard_error, 1)}"
    lacks = ", ".join(lacking(outputs))
    largest = f"{metadata.length_mm:g} mm, largest deflection {digits(metadata.max_deflection_mm, 4)} mm"
    rows = [
        ("model", f"{identity} ({metadata.estimator}, seed {metadata.seed})"),
        ("beam", f"{metadata.beam}: {largest}"),
        ("sensors", f"{layout} mm from the left end; at least {metadata.min_channels} must work"),
        ("mounted", f"fixed_mm = {[channel.position_mm for channel in metadata.layout]} in [sensors] keeps them there"),
        ("contact", f"{low:g}..{high:g} mm, {force}"),
        ("sensor", f"{gap}, {sensor.adc_bits} bits, {sensor.rate_hz:g} Hz"),
        (
            "floor",
            f"gains {_several(metadata.floor.gain, 100, '%')}, zeros {_several(metadata.floor.zero_mm, 1000, 'um')}",
        ),
        ("touch", _touch(metadata)),
        ("filter", "none" if chosen.kind == "none" else smoothing),
        ("noise", f"{digits(noise.reading_mm, 3)} mm per reading, {digits(noise.sample_mm, 3)} mm per sample"),
        ("error", f"{error} of the length, on average{_of_what(metadata)}"),
        ("limit", f"{best}; error over limit {ratio}"),
        *(("answer", f"{kind}: error {', '.join(errors)}") for kind, errors in answers(metadata).items()),
        *_placed(metadata),
        ("outputs", ", ".join(outputs)),
        *([("lacks", f"{lacks}: `design-sensors evaluate` can use it, the service cannot")] if lacks else []),
        ("golden", f"{len(metadata.golden.deflection_mm)} answers reproduced"),
        *_calibration(metadata),
    ]
    return "\n".join(f"{label:<8} {text}" for label, text in rows)


def _of_what(metadata: Metadata) -> str:
    chosen = metadata.filter
    return "" if chosen.kind == "none" else f", of the mean of {chosen.window} readings at rest"


def answers(metadata: Metadata) -> dict[str, list[str]]:
    """Return what an answer gives, and when, in words for each kind of touch."""
    kinds: dict[str, list[str]] = {"sudden touch": [], "touch without ringing": []}
    for answer in metadata.accuracy.since_touch:
        after = f"after {digits(answer.since_ms, 3)} ms"
        kinds["touch without ringing"].append(f"{_measured(answer.error_percent, answer.error_standard_error)} {after}")
        if answer.ringing_percent is not None:
            kinds["sudden touch"].append(f"{_measured(answer.ringing_percent, answer.ringing_standard_error)} {after}")
    return {kind: errors for kind, errors in kinds.items() if errors}


def _measured(percent: float, standard_error: float | None) -> str:
    """Return a figure to the digit that its standard error leaves."""
    if not standard_error:
        return f"{digits(percent, 2)} %"
    decimals = max(0, -math.floor(math.log10(standard_error)))
    return f"{percent:.{decimals}f} % +- {digits(standard_error, 1)}"


def lacking(outputs: Sequence[str]) -> list[str]:
    """Return the outputs of position, interval, log odds of contact and misfit that a graph does not have."""
    return [name for name in POSITION_OUTPUTS if name not in outputs]


def _several(values: list[float], factor: float, unit: str) -> str:
    """Return the values as one number, or as their range."""
    low, high = min(values) * factor, max(values) * factor
    return f"+- {digits(low, 2)} {unit}" if low == high else f"+- {digits(low, 2)}..{digits(high, 2)} {unit}"


def per_day(rate: float) -> str:
    """Return a number per day in words."""
    return f"{digits(rate, 2)} a day" if rate >= 1 else f"one in {digits(1 / rate, 3)} days"


def _touch(metadata: Metadata) -> str:
    seen, often = metadata.smallest_force.force_n, per_day(metadata.thresholds.false_contacts_per_day)
    best, left, right = (
        "none" if force is None else f"{digits(force, 2)} N" for force in (extremes(seen)[0], seen[0], seen[-1])
    )
    needed = f"smallest force seen: {best} at the best place, {left} and {right} at the ends of the range"
    return f"{needed}; false contacts at rest: {often}"


def extremes(smallest_n: Sequence[float | None]) -> tuple[float | None, float | None]:
    """Return the least and the largest of smallest forces; None, where nothing is seen, is larger than any."""
    seen = [force for force in smallest_n if force is not None]
    return min(seen, default=None), max(seen, default=None) if len(seen) == len(smallest_n) else None


def unseen(metadata: Metadata) -> str:
    """Say where the smallest force of the scene is not seen, and where nothing is; empty if it is seen everywhere.

    Right beside a support every force is missed. Where that is only a narrow stretch at an end of the range, with the
    support outside it, it is not told.
    """
    weakest, (low, high) = metadata.ranges.force_n[0], metadata.ranges.position_mm
    where, forces_n = [], []
    for run in _runs(metadata, lambda force: force is None or force > weakest):
        start, end, most = run[0][0], run[-1][0], extremes([force for _, force in run])[1]
        if most is None or end - start > NARROW * (high - low) or low < start <= end < high:
            where.append((start, end))
            forces_n += [most] if most is not None else []
    if not where:
        return ""
    words = [blind] if (blind := nothing_seen(metadata)) else []
    words += [f"up to {digits(max(forces_n), 2)} N is needed {'elsewhere' if blind else 'there'}"] if forces_n else []
    return (
        f"the scene's smallest force, {weakest:g} N, is missed in more than 5 % of samples at "
        f"{' and '.join(_in_words(*stretch) for stretch in where)}: {', and '.join(words)}"
    )


def nothing_seen(metadata: Metadata) -> str:
    """Say where nothing is seen: at a support, or elsewhere; empty if there is no such place."""
    words = []
    for run in _runs(metadata, lambda force: force is None):
        start, end = run[0][0], run[-1][0]
        held = [support.at_mm for support in metadata.drawn.supports if start <= support.at_mm <= end]
        words += [f"the support at {digits(support_mm, 4)} mm" for support_mm in held] or [_in_words(start, end)]
    return f"nothing is seen at {' and '.join(words)}" if words else ""


def _runs(metadata: Metadata, is_wanted: Callable[[float | None], bool]) -> Iterator[list[tuple[float, float | None]]]:
    """Yield the runs of places whose smallest force is wanted, as position and force."""
    pairs = zip(metadata.smallest_force.position_mm, metadata.smallest_force.force_n, strict=True)
    yield from (list(run) for wanted, run in groupby(pairs, lambda pair: is_wanted(pair[1])) if wanted)


def _in_words(low_mm: float, high_mm: float) -> str:
    return f"{digits(low_mm, 4)} mm" if low_mm == high_mm else f"{digits(low_mm, 4)}..{digits(high_mm, 4)} mm"


def _placed(metadata: Metadata) -> list[tuple[str, str]]:
    placed = metadata.placed
    if not placed.limit_without_percent:
        return []
    worst = max(placed.limit_without_percent)
    index = placed.limit_without_percent.index(worst)
    name, grown = metadata.layout[index].name, _measured(worst, placed.limit_without_standard_error[index])
    spare = ", with a spare" if placed.spare else ""
    return [("placed", f"by {placed.criterion}{spare}; the limit grows to {grown} if {name} fails")]


def _calibration(metadata: Metadata) -> list[tuple[str, str]]:
    calibration = metadata.calibration
    if calibration is None:
        return []
    kinds = ", ".join(calibration.fitted) or "no departures"
    told = []
    if calibration.error_before_mm is not None and calibration.error_after_mm is not None:
        told.append(
            f"{calibration.loads} loads, mean error {digits(calibration.error_before_mm, 3)} mm before, "
            f"{digits(calibration.error_after_mm, 3)} mm after"
        )
    if calibration.misfit_before is not None and calibration.misfit_after is not None:
        told.append(
            f"{calibration.contacts} unlabelled contacts, median misfit {digits(calibration.misfit_before, 3)} before, "
            f"{digits(calibration.misfit_after, 3)} after"
        )
    return [("real", f"calibrated with {'; then with '.join(told)}; fitted: {kinds}")]
