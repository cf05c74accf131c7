"""The parts list of a surface: holes, sensors and settings, row by row, with those that the scene states marked."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.units import MM, direction_of, fine
from beamtouch_models.design.physics.motion import damping_of
from beamtouch_models.design.pricing.noise import ReadingErrors
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.scene.plausible_plate import xy_of
from beamtouch_models.design.surface import Surface
from beamtouch_models.places import in_rows
from beamtouch_models.runtime.metadata import Metadata

PLACE_HEADS = (
    ("sensor", "from the left end", "from the right end", "to the next", "housing"),
    ("sensor", "x, from the left", "y, from below", "from the right", "from above", "to the nearest"),
)
"""Headings of the places of sensors, on a beam and on a plate."""


@dataclass(frozen=True)
class Place:
    """The place of a sensor, to the middle of its housing."""

    name: str
    distances: tuple[str, ...]
    """In mm, as `PLACE_HEADS` names them. Steps to other sensors are from middle to middle."""
    is_fixed: bool
    """True if the scene put it there."""


def places_of(scene: Scene, metadata: Metadata) -> list[Place]:
    """Return where the sensors stand: on a beam from left to right, on a plate in the order of the channels."""
    if len(metadata.axes) > 1:
        return _places_on_plate(scene, metadata)
    half_mm, fixed, length_mm = scene.sensors.size_mm / 2, set(scene.sensors.fixed_mm), metadata.length_mm
    in_order = sorted(metadata.layout, key=lambda channel: channel.position_mm)
    steps = [*(f"{after.position_mm - channel.position_mm:g}" for channel, after in pairwise(in_order)), "-"]
    return [
        Place(
            channel.name,
            (f"{at:g}", f"{length_mm - at:g}", step, f"{at - half_mm:g} to {at + half_mm:g}"),
            at in fixed,
        )
        for channel, step in zip(in_order, steps, strict=True)
        for at in (channel.position_mm,)
    ]


def _places_on_plate(scene: Scene, metadata: Metadata) -> list[Place]:
    places_mm, fixed, size_mm = metadata.layout_mm, [xy_of(place) for place in scene.sensors.fixed], metadata.size_mm
    apart = np.linalg.norm(places_mm[:, None] - places_mm, axis=2) + np.diag(np.full(len(places_mm), np.inf))
    return [
        Place(
            channel.name,
            (
                *(f"{at:g}" for at in place),
                *(f"{length - at:g}" for length, at in zip(size_mm, place, strict=True)),
                digits(nearest, 4) if np.isfinite(nearest) else "-",
            ),
            place in fixed,
        )
        for channel, place, nearest in zip(
            metadata.layout, map(tuple, places_mm.tolist()), apart.min(axis=1).tolist(), strict=True
        )
    ]


Source = Literal["stated", "assumed", "computed"]


def _source(*, stated: bool) -> Source:
    return "stated" if stated else "assumed"


@dataclass(frozen=True)
class Part:
    """Something to buy, to set or to keep to."""

    name: str
    value: str
    remark: str
    source: Source
    """True if the scene states it; "computed" marks what follows from that."""


def parts_of(surface: Surface, metadata: Metadata) -> list[Part]:
    """Return what the surface is made of, and the errors that its sensors may have, as standard deviations."""
    scene, sensor = surface.scene, metadata.sensor
    moved_mm, unit = metadata.ranges.force_n[1] * np.array(metadata.influence.mm_per_n), metadata.unit
    extremes_mm = max(moved_mm.max(), 0.0), min(moved_mm.min(), 0.0)
    ends_mm = [sensor.standoff_mm + direction_of(unit) * float(moved) for moved in extremes_mm]
    return [
        *_of_structure(scene),
        Part(
            "sensors",
            f"{len(metadata.layout)}, all alike",
            f"housings at most {scene.sensors.size_mm:g} mm wide{'' if scene.has_two_axes else ' along the beam'}",
            _source(stated="size_mm" in scene.sensors.model_fields_set),
        ),
        Part(
            "linear range",
            f"{sensor.range_mm[0]:g} to {sensor.range_mm[1]:g} {unit}",
            f"{quantity_of(unit)}s between which a sensor measures",
            _source(stated="range_mm" in scene.sensors.model_fields_set),
        ),
        Part(
            f"{quantity_of(unit)} at rest",
            f"{digits(sensor.standoff_mm, 3)} {unit}",
            f"set it with the {'plate' if scene.has_two_axes else 'beam'} in place; with "
            f"{metadata.ranges.force_n[1]:g} N lying on it, sensors see "
            f"{digits(min(ends_mm), 3)} to {digits(max(ends_mm), 3)} {unit}",
            "computed" if scene.sensors.standoff_mm is None else "stated",
        ),
        Part(
            "resolution",
            f"{sensor.adc_bits} bits",
            f"{typeset(abs(sensor.gain_mm_per_count), unit)} a count",
            _source(stated=scene.sensors.adc_bits is not None),
        ),
        Part(
            "rate",
            f"{sensor.rate_hz:g} a second",
            "readings of every sensor",
            _source(stated="rate_hz" in scene.sensors.model_fields_set),
        ),
        *_of_errors(scene, surface.readings, unit),
        *([] if scene.measured is not None else [_mounting(surface, metadata)]),  # sensors stay where they stood then
        _temperature(scene),
    ]


def quantity_of(unit: str) -> str:
    """Return the word for what a sensor with a unit measures."""
    return "gap" if unit == MM else "value"


def typeset(value: float, unit: str, count: int = 3) -> str:
    """Return a small value with its unit, typeset."""
    return fine(value, unit, count).replace(" um", " µm")


def _of_structure(scene: Scene) -> Iterator[Part]:
    if scene.plate is not None:
        return _of_plate(scene.plate)
    return _of_beam(scene.beam) if scene.has_beam else _of_measured(scene)


def _of_plate(plate: Plate) -> Iterator[Part]:
    size = f"{plate.length_x_mm:g} x {plate.length_y_mm:g} x {plate.thickness_mm:g} mm"
    stiff = f"E = {plate.modulus_gpa:g} GPa, Poisson's ratio {plate.poisson:g}"
    told = [text for text in (plate.material or "", stiff) if text]
    yield Part("plate", size, ", ".join(told), "stated")
    yield Part("supports", f"{len(plate.support_list)}", supports_in_words(plate), "stated")
    if plate.density_kg_m3 is not None or plate.material is not None:
        yield _damping(plate)


def supports_in_words(plate: Plate) -> str:
    """Return how a plate is held, those that are alike together."""
    kinds: dict[str, list[str]] = {}
    for support in plate.support_list:
        if support.is_line:
            at = f"x = {support.x_mm:g}" if support.y_mm is None else f"y = {support.y_mm:g}"
        else:
            at = f"({support.x_mm:g}, {support.y_mm:g})"
        stiffness = support.stiffness_n_per_mm
        held = "rigid" if stiffness is None else f"springs of {stiffness:g} N/mm"
        kinds.setdefault(held, []).append(at)
    return "; ".join(f"{held} at {', '.join(places)} mm" for held, places in kinds.items())


def _damping(structure: Beam | Plate) -> Part:
    damping = f"{digits(100 * damping_of(structure), 2)} %"
    source = _source(stated=structure.damping_ratio is not None)
    return Part("damping", damping, "of critical; with less, it rings longer", source)


def _of_beam(beam: Beam) -> Iterator[Part]:
    if beam.segments:
        size = f"{beam.length_mm:g} mm long, in {len(beam.segments)} sections"
    elif beam.width_mm is None or beam.thickness_mm is None:
        size = f"{beam.length_mm:g} mm long"
    else:
        size = f"{beam.length_mm:g} x {beam.width_mm:g} x {beam.thickness_mm:g} mm"
    modulus_gpa, rigidity = beam.modulus_gpa, beam.flexural_rigidity_n_mm2
    stiff = f"E I = {rigidity:.4g} N mm²" if rigidity else f"E = {modulus_gpa:g} GPa" if modulus_gpa else ""
    told = [text for text in (beam.material or "", stiff) if text]
    yield Part("beam", size, ", ".join(told), "stated")
    if beam.density_kg_m3 is not None or beam.material is not None:
        yield _damping(beam)


def _of_measured(scene: Scene) -> Iterator[Part]:
    if scene.measured is not None:
        loads = scene.measured.loads
        told = f"its influence was measured with {len(loads.force_n)} loads at {len(loads.names)} sensors"
        size = " x ".join(f"{length_mm:g}" for length_mm in scene.size_mm)
        yield Part("structure", f"{size} mm", told, "stated")


def _of_errors(scene: Scene, readings: ReadingErrors, unit: str) -> Iterator[Part]:
    sensors, environment = scene.sensors, scene.environment
    yield Part("noise", typeset(readings.reading_mm, unit), "of a reading, at most", "stated")
    yield Part(
        "gain",
        f"± {digits(100 * readings.gain, 2)} %",
        "of each sensor, after calibration",
        _source(stated=sensors.gain_error_percent is not None),
    )
    yield Part(
        "zero",
        f"± {typeset(readings.drift_mm, unit, 2)}",
        "of each sensor, since the last tare",
        _source(stated=sensors.zero_drift_mm is not None),
    )
    yield Part(
        "drift",
        f"± {typeset(readings.drift_mm_per_min, unit, 2)} a minute",
        "of all zeros together, as a hall warms",
        _source(stated=environment.drift_um_per_min is not None),
    )


def shows_mm(surface: Surface, metadata: Metadata) -> float:
    """Return how far beside its place a sensor must stand to move a sample by its noise, under the largest force."""
    influence, sensor_mm = surface.influence, in_rows(metadata.layout_mm, len(metadata.axes))
    per_mm = np.sqrt(influence.variance(sensor_mm, influence.place_mm, 1.0)).max()
    return float(metadata.noise.sample_mm / (metadata.ranges.force_n[1] * per_mm)) if per_mm else np.inf


def _mounting(surface: Surface, metadata: Metadata) -> Part:
    along = "" if surface.scene.has_two_axes else " along the beam"
    sensors, most_mm = surface.scene.sensors, shows_mm(surface, metadata)
    tolerance_mm = sensors.mounting_tolerance_mm
    shows = f"; one that is {digits(most_mm, 2)} mm off shows over the noise" if np.isfinite(most_mm) else ""
    return Part(
        "mounting",
        f"± {tolerance_mm:g} mm" if tolerance_mm else "exact",
        f"places{along}{shows}: measure where it stands, or calibrate",
        _source(stated="mounting_tolerance_mm" in sensors.model_fields_set),
    )


def _temperature(scene: Scene) -> Part:
    range_k = scene.environment.temperature_range_k
    return Part(
        "temperature",
        "constant" if range_k is None else f"{range_k[0]:+g} to {range_k[1]:+g} K",
        f"beside that at which the {'plate' if scene.has_two_axes else 'beam'} is mounted",
        _source(stated=range_k is not None),
    )
