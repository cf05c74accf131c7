"""A model file in words, for every command that describes one."""

from collections.abc import Sequence
from itertools import groupby

from beamtouch_common.digits import digits
from beamtouch_models.metadata import POSITION_OUTPUTS, Metadata

BLIND = 10.0
"""Where more than this many times the largest force of a scene is needed, no force is seen: near a support."""


def summary(metadata: Metadata, identity: str, outputs: Sequence[str]) -> str:
    """Return the metadata as text, each number with its unit and reference."""
    accuracy, noise, chosen, sensor = metadata.accuracy, metadata.noise, metadata.filter, metadata.sensor
    layout = ", ".join(f"{channel.name} {channel.position_mm:g}" for channel in metadata.layout)
    low, high = metadata.ranges.position_mm
    weak, strong = metadata.ranges.force_n
    force = f"{weak:g} N, known" if weak == strong else f"{weak:g}..{strong:g} N, unknown"
    gap = f"gap {sensor.range_mm[0]:g}..{sensor.range_mm[1]:g} mm, {digits(sensor.standoff_mm, 4)} mm at rest"
    smoothing = f"{chosen.kind} of {chosen.window} readings, settled after {chosen.settling_ms:g} ms"
    error = f"{accuracy.error_percent:.3f} % +- {digits(accuracy.error_standard_error, 1)}"
    best = f"{accuracy.limit_percent:.3f} % +- {digits(accuracy.limit_standard_error, 1)}"
    ratio = f"{accuracy.ratio:.3f} +- {digits(accuracy.ratio_standard_error, 1)}"
    lacks = ", ".join(lacking(outputs))
    rows = [
        ("model", f"{identity} ({metadata.estimator}, seed {metadata.seed})"),
        ("beam", f"{metadata.length_mm:g} mm, largest deflection {digits(metadata.max_deflection_mm, 4)} mm"),
        ("sensors", f"{layout} mm from the left end; at least {metadata.min_channels} must work"),
        ("contact", f"{low:g}..{high:g} mm, {force}"),
        ("sensor", f"{gap}, {sensor.adc_bits} bits, {sensor.rate_hz:g} Hz"),
        (
            "floor",
            f"gains {_several(metadata.floor.gain, 100, '%')}, zeros {_several(metadata.floor.zero_mm, 1000, 'um')}",
        ),
        ("touch", _touch(metadata)),
        ("filter", "none" if chosen.kind == "none" else smoothing),
        ("noise", f"{digits(noise.reading_mm, 3)} mm per reading, {digits(noise.sample_mm, 3)} mm per sample"),
        ("error", f"{error} of the length, on average"),
        ("limit", f"{best}; error over limit {ratio}"),
        *_placed(metadata),
        ("outputs", ", ".join(outputs)),
        *([("lacks", f"{lacks}: `design-sensors evaluate` can use it, the service cannot")] if lacks else []),
        ("golden", f"{len(metadata.golden.deflection_mm)} answers reproduced"),
        *_calibration(metadata),
    ]
    return "\n".join(f"{label:<8} {text}" for label, text in rows)


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
    most_n = BLIND * metadata.ranges.force_n[1]
    left, right = (f"{digits(force, 2)} N" if force <= most_n else "none" for force in (seen[0], seen[-1]))
    needed = (
        f"smallest force seen: {digits(min(seen), 2)} N at the best place, {left} and {right} at the ends of the range"
    )
    return f"{needed}; false contacts at rest: {often}"


def unseen(metadata: Metadata) -> str:
    """Say where the smallest force of the scene is not seen, and where none is; empty if it is seen everywhere.

    The very ends of the range are not told, because supports often stand there, beside which every force is missed.
    """
    weakest, most_n = metadata.ranges.force_n[0], BLIND * metadata.ranges.force_n[1]
    pairs = list(zip(metadata.smallest_force.position_mm, metadata.smallest_force.force_n, strict=True))
    missed, blind = _stretches(pairs, weakest), _stretches(pairs, most_n)
    if not missed:
        return ""
    needed = max((force for run in missed for _, force in run if force <= most_n), default=weakest)
    words = [f"up to {digits(needed, 2)} N is needed there"] if needed > weakest else []
    where = "there" if blind == missed else f"at {_in_words(blind)}"
    words += [f"{where} the beam hardly moves, and no force is seen"] if blind else []
    return (
        f"the scene's smallest force, {weakest:g} N, is missed in more than 5 % of samples at {_in_words(missed)}: "
        f"{'; '.join(words)}"
    )


Stretch = list[tuple[float, float]]
"""Neighbouring positions, with the force that is needed at each."""


def _stretches(needed: Stretch, force_n: float) -> list[Stretch]:
    """Return the stretches where more than a force is needed to be seen, without single places at either end."""
    runs = [list(run) for is_missed, run in groupby(needed, lambda pair: pair[1] > force_n) if is_missed]
    return [run for run in runs if len(run) > 1 or run[0] not in (needed[0], needed[-1])]


def _in_words(stretches: list[Stretch]) -> str:
    ends = [(run[0][0], run[-1][0]) for run in stretches]
    words = [digits(low, 4) if low == high else f"{digits(low, 4)}..{digits(high, 4)}" for low, high in ends]
    return " and ".join(f"{one} mm" for one in words)


def _placed(metadata: Metadata) -> list[tuple[str, str]]:
    found = metadata.placed
    if found is None or not found.limit_without_percent:
        return []
    worst = max(found.limit_without_percent)
    name = metadata.layout[found.limit_without_percent.index(worst)].name
    spare = ", with a spare" if found.spare else ""
    return [("placed", f"by {found.criterion}{spare}; the limit grows to {digits(worst, 3)} % if {name} fails")]


def _calibration(metadata: Metadata) -> list[tuple[str, str]]:
    found = metadata.calibration
    if found is None:
        return []
    kinds = ", ".join(found.fitted) or "no departures"
    told = []
    if found.error_before_mm is not None and found.error_after_mm is not None:
        told.append(
            f"{found.loads} loads, mean error {digits(found.error_before_mm, 3)} mm before, "
            f"{digits(found.error_after_mm, 3)} mm after"
        )
    if found.misfit_before is not None and found.misfit_after is not None:
        told.append(
            f"{found.contacts} unlabelled contacts, median misfit {digits(found.misfit_before, 3)} before, "
            f"{digits(found.misfit_after, 3)} after"
        )
    return [("real", f"calibrated with {'; then with '.join(told)}; fitted: {kinds}")]
