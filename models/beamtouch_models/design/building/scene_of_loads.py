"""The scene of a structure of which nothing is known but recorded loads, as `beamtouch-daemon record` writes them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.encodings import decode
from beamtouch_common.units import MM, fine
from beamtouch_models.design.building.recorded_noise import independent_variance
from beamtouch_models.design.rows import RecordingError, Row, read_rows
from beamtouch_models.design.scene import Scene, make_scene
from beamtouch_models.design.scene.measured_loads import (
    MeasuredLoads,
    column_of,
    parse_loads,
    place_columns,
    rows_of_loads,
)

FEWEST = 5
"""Samples of a load that tell its noise."""
LIGHTER = 5.0
"""Largest force over the smallest one that the scene allows, unless lighter loads were recorded."""
ROOM = 1.25
"""Range of the sensors over what they showed, at least."""
NEAREST_MM, USUAL_MM = 1.0, 3.0
"""Smallest gap of the sensors, and their range."""
LATENCY_MS, RATE_HZ = 50.0, 100.0
"""Time to an answer, and readings per second where the recording has no times."""
WHOLE = 0.01
"""A rate is a whole number if that is not farther off: polls come a little late."""


def scene_of_loads(path: Path) -> Scene:
    """Return the scene of a recording: contacts and forces as recorded, and the noise of its samples.

    Raises
    ------
    InputError
        It is no recording of known loads, or its loads have too few samples to tell their noise.
    """
    rows, _ = read_rows(path)
    loads = parse_loads(decode(path.read_bytes()), str(path))
    if loads.is_per_newton:
        raise RecordingError(f"{path}: it has influence, not loads; name it in a scene: [measured] influence = ...")
    noise_mm, rate_hz = _noise_mm(rows, loads, path), _rate_hz(rows)
    largest_n = float(loads.force_n.max())
    return make_scene(
        measured={"influence": loads.to_csv()},
        contact={
            "force_n": [min(float(loads.force_n.min()), largest_n / LIGHTER), largest_n],
            **{
                column: [float(along.min()), float(along.max())]
                for column, along in zip(place_columns(loads.axes), loads.place_mm.T, strict=True)
            },
        },
        sensors={
            "noise_mm": noise_mm,
            "rate_hz": rate_hz,
            "range_mm": _range_mm(loads),
        },
        requirements={"latency_ms": max(LATENCY_MS, 1e3 / rate_hz), "descriptors": ["position", "force"]},
    )


def _range_mm(loads: MeasuredLoads) -> list[float]:
    """Return a range of sensors that has room for all that they showed, whatever they show at rest."""
    travel_mm = ROOM * float(np.ptp(np.append(loads.deflection_mm, 0.0)))
    if loads.unit == MM:
        return [NEAREST_MM, NEAREST_MM + max(USUAL_MM, travel_mm)]
    return [-float(digits(travel_mm, 3)), float(digits(travel_mm, 3))]


def assumed_of(scene: Scene) -> str:
    """Say what the scene of a recording takes from it."""
    weak, strong = scene.contact.force_range_n
    places = " by ".join(f"{low:g} to {high:g}" for low, high in scene.contact.ranges_mm)
    noise, rate_hz = fine(scene.sensors.noise_mm or 0.0, scene.unit), scene.sensors.rate_hz
    return (
        f"taken from the loads: contacts at {places} mm with {digits(weak, 3)} to {digits(strong, 3)} N, "
        f"{noise} of noise in each of {digits(rate_hz, 3)} samples a second; `design-sensors inspect` shows all, "
        "and a scene with [measured] states it otherwise"
    )


def _noise_mm(rows: Sequence[Row], loads: MeasuredLoads, path: Path) -> float:
    """Return the noise of a reading from the samples within loads; RecordingError if loads have too few."""
    series = []
    for own in rows_of_loads(rows).values():
        for name in loads.names:
            good = [rows[index] for index in own if rows[index].cells.get(f"{name}_quality", "good") == "good"]
            shown = np.array([row.number_in(column_of(name, loads.unit)) for row in good])
            if len(shown) >= FEWEST:
                series.append(shown)
    if not any(np.ptp(shown) > 0 for shown in series):
        raise RecordingError(
            f"{path}: no load has {FEWEST} samples that differ, which tell the noise; record loads with "
            "beamtouch-daemon record, or state sensors.noise_mm in a scene with [measured]"
        )
    _, variance = independent_variance(series)
    return float(np.sqrt(variance))


def _rate_hz(rows: Sequence[Row]) -> float:
    """Return the samples per second within loads; a usual number if the recording has no times."""
    try:
        seconds = np.array([float(row.cells.get("unix_time_s", "")) for row in rows])
    except ValueError:
        return RATE_HZ
    steps = np.diff(seconds)
    steps = steps[steps > 0]
    if not len(steps):
        return RATE_HZ
    rate_hz = 1 / float(np.median(steps))
    whole_hz = round(rate_hz)
    return float(whole_hz) if abs(whole_hz - rate_hz) <= WHOLE * rate_hz else float(digits(rate_hz, 3))
