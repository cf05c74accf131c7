"""A model file in words, for every command that describes one."""

import tomllib
from collections.abc import Callable, Iterator, Sequence
from itertools import groupby

from beamtouch_common.digits import digits
from beamtouch_common.outline import names_of
from beamtouch_common.table import in_columns
from beamtouch_common.units import MM, fine
from beamtouch_models.names import Criterion
from beamtouch_models.numbers import rounded, with_error
from beamtouch_models.places import in_words
from beamtouch_models.runtime.force_range import ForceRange
from beamtouch_models.runtime.metadata import EVIDENCE_OUTPUTS, Metadata

SOUGHT: dict[Criterion, str] = {
    "position-error": "the least position error",
    "eigenvalue-product": "the largest product of eigenvalues, as in the paper",
}
"""The goal of each criterion of placement, in words."""
NARROW = 0.015
"""Share of the range of contacts that a stretch at one of its ends must exceed to be told."""


def summary(metadata: Metadata, identity: str, outputs: Sequence[str]) -> str:
    """Return the metadata as text, each number with its unit and reference."""
    accuracy, noise, chosen, sensor = metadata.accuracy, metadata.noise, metadata.filter, metadata.sensor
    places = [in_words(place) for place in metadata.layout_mm]
    layout = ", ".join(f"{channel.name} {place}" for channel, place in zip(metadata.layout, places, strict=True))
    where = " and ".join(f"from {low:g} to {high:g} mm" for low, high in metadata.extent.ranges_mm)
    weak, strong = metadata.ranges.force_n
    known = "not known in advance" if ForceRange(weak, strong).is_open else "known to be within this range"
    force = f"{weak:g} N, an exact force" if weak == strong else f"{weak:g} to {strong:g} N, {known}"
    unit = metadata.unit
    values = "gaps" if unit == MM else "values"
    gaps = f"linear over {values} of {sensor.range_mm[0]:g} to {sensor.range_mm[1]:g} {unit}"
    least, most = str(chosen.window), "" if chosen.max_readings == chosen.window else f" to {chosen.max_readings}"
    mm, is_beam = metadata.diagonal_mm / 100, len(metadata.axes) == 1
    # Sensors of a measured structure stand where they were measured.
    kept = f"fixed_mm = {metadata.layout_mm.tolist()} in [sensors] keeps them there"
    is_placed = is_beam and "measured" not in tomllib.loads(metadata.scene)
    origin, whole = ("left end", "length") if is_beam else ("corner", "diagonal")
    error = with_error(accuracy.error_percent * mm, accuracy.error_standard_error * mm, unit=" mm")
    best = with_error(accuracy.limit_percent * mm, accuracy.limit_standard_error * mm, unit=" mm")
    share = rounded(accuracy.error_percent, accuracy.error_standard_error)
    ratio = with_error(accuracy.ratio, accuracy.ratio_standard_error)
    lacks, floor = ", ".join(lacking(metadata, outputs)), metadata.floor
    bends = f"{'bends by' if unit == MM else 'shows'} up to {digits(metadata.max_deflection_mm, 3)} {unit}"
    rows = [
        ("model", f"{identity}, estimator {metadata.estimator}, seed {metadata.seed}"),
        _structure(metadata, bends),
        (
            "sensors",
            f"{layout} mm from the {origin}; at least {metadata.min_channels} must work",
        ),
        *([("mounted", kept)] if is_placed else []),
        ("contact", f"{where}, with {force}"),
        ("error", f"{error} on average ({share} % of the {whole}){_of_what(metadata)}"),
        ("limit", f"{best}, the best possible with these sensors; error over limit {ratio}"),
        *(("answer", f"{kind}: off by {', '.join(errors)}") for kind, errors in answers(metadata).items()),
        *_failed(metadata),
        ("touch", _touch(metadata)),
        ("rest", f"false contacts while nothing touches: {per_day(metadata.thresholds.false_contacts_per_day)}"),
        (
            "sensor",
            f"{gaps}, {digits(sensor.standoff_mm, 3)} {unit} at rest; {sensor.adc_bits} bits, {sensor.rate_hz:g} "
            "readings a second",
        ),
        (
            "noise",
            f"{fine(noise.reading_mm, unit)} per reading, {fine(noise.sample_mm, unit)} per sample",
        ),
        ("filter", "none" if chosen.kind == "none" else f"{chosen.kind} of {least}{most} readings"),
        (
            "floor",
            f"gains {_several(floor.gain, 100, '%')}, zeros {_zeros(floor.zero_mm, unit)}, "
            "which no filter averages away",
        ),
        ("outputs", ", ".join(outputs)),
        *([("lacks", f"{lacks}: `design-sensors evaluate` can use it, the service cannot")] if lacks else []),
        ("checked", f"the graph gives the {len(metadata.golden.deflection_mm)} answers that were stored with it"),
        *_calibration(metadata),
        ("+-", "a standard error; in `floor`, a standard deviation"),
    ]
    return "\n".join(in_columns(rows))


def _structure(metadata: Metadata, bends: str) -> tuple[str, str]:
    if metadata.width_mm is None:
        return "beam", f"{metadata.length_mm:g} mm long, {bends}; identity {metadata.beam}"
    return "plate", f"{metadata.length_mm:g} by {metadata.width_mm:g} mm, {bends}; identity {metadata.beam}"


def _of_what(metadata: Metadata) -> str:
    chosen = metadata.filter
    return "" if chosen.kind == "none" else f", with {chosen.window} readings of a load at rest"


def answers(metadata: Metadata) -> dict[str, list[str]]:
    """Return the mean errors in mm of answers by the time since a touch, in words for each kind of touch.

    A sudden touch makes the beam ring, a gentle one does not.
    """
    kinds: dict[str, list[str]] = {"sudden touch": [], "gentle touch": []}
    for answer in metadata.accuracy.since_touch:
        for kind, percent in (("sudden touch", answer.ringing_percent), ("gentle touch", answer.error_percent)):
            if percent is not None:
                error_mm = digits(percent * metadata.diagonal_mm / 100, 2)
                kinds[kind].append(f"{error_mm} mm at {digits(answer.since_ms, 3)} ms")
    return {kind: errors for kind, errors in kinds.items() if errors}


def lacking(metadata: Metadata, outputs: Sequence[str]) -> list[str]:
    """Return the outputs of place, interval, log odds of contact and misfit that a graph does not have."""
    places = [name for axis in metadata.axes for name in names_of(axis, "mm")]
    return [name for name in (*places, *EVIDENCE_OUTPUTS) if name not in outputs]


def _several(values: list[float], factor: float, unit: str) -> str:
    """Return the values as one number, or as their range."""
    low, high = min(values) * factor, max(values) * factor
    return f"+- {digits(low, 2)} {unit}" if low == high else f"+- {digits(low, 2)}..{digits(high, 2)} {unit}"


def _zeros(zero_mm: list[float], unit: str) -> str:
    return _several(zero_mm, 1000, "um") if unit == MM else _several(zero_mm, 1, unit)


def per_day(rate: float) -> str:
    """Return a number per day in words."""
    return f"{digits(rate, 2)} a day" if rate >= 1 else f"one in {digits(1 / rate, 3)} days"


def _touch(metadata: Metadata) -> str:
    seen = metadata.smallest_force.force_n
    if len(metadata.axes) > 1:
        best, worst = ("nothing" if force is None else f"{digits(force, 2)} N" for force in extremes(seen))
        return f"smallest force seen: {best} at the best place, {worst} at the worst"
    best, *ends = (
        "nothing" if force is None else f"{digits(force, 2)} N" for force in (extremes(seen)[0], seen[0], seen[-1])
    )
    return f"smallest force seen: {best} at the best place, {' and '.join(dict.fromkeys(ends))} at the ends"


def extremes(smallest_n: Sequence[float | None]) -> tuple[float | None, float | None]:
    """Return the least and the largest of smallest forces; None, where nothing is seen, is larger than any."""
    seen = [force for force in smallest_n if force is not None]
    return min(seen, default=None), max(seen, default=None) if len(seen) == len(smallest_n) else None


def unseen(metadata: Metadata) -> str:
    """Say where the smallest force of the scene is not seen, and where nothing is; empty if it is seen everywhere.

    Right beside a support every force is missed. Where that is only a narrow stretch at an end of the range, with the
    support outside it, it is not told.
    """
    if len(metadata.axes) > 1:
        return _unseen_on_plate(metadata)
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


def _unseen_on_plate(metadata: Metadata) -> str:
    """Say on how much of a plate the smallest force of the scene is not seen; empty if it is seen everywhere."""
    weakest, forces_n = metadata.ranges.force_n[0], metadata.smallest_force.force_n
    missed = [force for force in forces_n if force is None or force > weakest]
    if not missed:
        return ""
    most = extremes(missed)[1]
    needed = "nothing is seen on some of it" if most is None else f"up to {digits(most, 2)} N is needed there"
    share = digits(100 * len(missed) / len(forces_n), 2)
    return (
        f"the scene's smallest force, {weakest:g} N, is missed in more than 5 % of samples on {share} % of the area of "
        f"contacts: {needed}"
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
    return f"{digits(low_mm, 3)} mm" if low_mm == high_mm else f"{digits(low_mm, 3)} to {digits(high_mm, 3)} mm"


def _failed(metadata: Metadata) -> list[tuple[str, str]]:
    placed, mm = metadata.placed, metadata.diagonal_mm / 100
    if not placed.limit_without_percent:
        return []
    worst = max(placed.limit_without_percent)
    index = placed.limit_without_percent.index(worst)
    grown = with_error(worst * mm, placed.limit_without_standard_error[index] * mm, unit=" mm")
    failed = f", with the worst sensor failed {placed.failed_percent:g} % of the time" if placed.failed_percent else ""
    found = f"the limit grows to {grown} if {metadata.layout[index].name} fails, the worst to lose"
    return [("failed", found), ("placed", f"for {SOUGHT[placed.criterion]}{failed}")]


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
    return [("fitted", f"to the real beam, with {'; then with '.join(told)}; departures: {kinds}")]
