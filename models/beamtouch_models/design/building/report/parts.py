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
from beamtouch_models.design.surface import Surface
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.metadata import Metadata


@dataclass(frozen=True)
class Place:
    """The position of a sensor."""

    name: str
    from_left_mm: float
    """From the left end of the beam to the middle of the housing."""
    from_right_mm: float
    to_next_mm: float | None
    """From middle to middle, to the next sensor on the right; None for the last one."""
    housing_mm: tuple[float, float]
    """Both sides of the housing, from the left end."""
    is_fixed: bool
    """True if the scene put it there."""


def places_of(scene: Scene, metadata: Metadata) -> list[Place]:
    """Return where the sensors stand, from left to right."""
    half_mm, fixed = scene.sensors.size_mm / 2, set(scene.sensors.fixed_mm)
    in_order = sorted(metadata.layout, key=lambda channel: channel.position_mm)
    steps = [*(after.position_mm - channel.position_mm for channel, after in pairwise(in_order)), None]
    return [
        Place(
            channel.name,
            channel.position_mm,
            metadata.length_mm - channel.position_mm,
            step,
            (channel.position_mm - half_mm, channel.position_mm + half_mm),
            channel.position_mm in fixed,
        )
        for channel, step in zip(in_order, steps, strict=True)
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
        *(_of_beam(scene) if scene.has_beam else _of_measured(scene)),
        Part(
            "sensors",
            f"{len(metadata.layout)}, all alike",
            f"housings at most {scene.sensors.size_mm:g} mm wide along the beam",
            _source(stated="size_mm" in scene.sensors.model_fields_set),
        ),
        Part(
            "linear range",
            f"{sensor.range_mm[0]:g} to {sensor.range_mm[1]:g} {unit}",
            f"{'gaps' if unit == MM else 'values'} between which a sensor measures",
            _source(stated="range_mm" in scene.sensors.model_fields_set),
        ),
        Part(
            "gap at rest" if unit == MM else "value at rest",
            f"{digits(sensor.standoff_mm, 3)} {unit}",
            f"set it with the beam in place; with {metadata.ranges.force_n[1]:g} N lying on it, sensors see "
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
        _mounting(surface, metadata),
        _temperature(scene),
    ]


def typeset(value: float, unit: str, count: int = 3) -> str:
    """Return a small value with its unit, typeset."""
    return fine(value, unit, count).replace(" um", " µm")


def _of_beam(scene: Scene) -> Iterator[Part]:
    beam = scene.beam
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
        damping = f"{digits(100 * damping_of(beam), 2)} %"
        source = _source(stated=beam.damping_ratio is not None)
        yield Part("damping", damping, "of critical; with less, it rings longer", source)


def _of_measured(scene: Scene) -> Iterator[Part]:
    if scene.measured is not None:
        loads = scene.measured.loads
        told = f"its influence was measured with {len(loads.force_n)} loads at {len(loads.names)} sensors"
        yield Part("structure", f"{scene.length_mm:g} mm long", told, "stated")


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
    influence, sensor_mm = surface.influence, on_axis(metadata.layout_mm)
    per_mm = np.sqrt(influence.variance(sensor_mm, influence.place_mm, 1.0)).max()
    return float(metadata.noise.sample_mm / (metadata.ranges.force_n[1] * per_mm)) if per_mm else np.inf


def _mounting(surface: Surface, metadata: Metadata) -> Part:
    sensors, most_mm = surface.scene.sensors, shows_mm(surface, metadata)
    tolerance_mm = sensors.mounting_tolerance_mm
    shows = f"; one that is {digits(most_mm, 2)} mm off shows over the noise" if np.isfinite(most_mm) else ""
    return Part(
        "mounting",
        f"± {tolerance_mm:g} mm" if tolerance_mm else "exact",
        f"places along the beam{shows}: measure where it stands, or calibrate",
        _source(stated="mounting_tolerance_mm" in sensors.model_fields_set),
    )


def _temperature(scene: Scene) -> Part:
    range_k = scene.environment.temperature_range_k
    return Part(
        "temperature",
        "constant" if range_k is None else f"{range_k[0]:+g} to {range_k[1]:+g} K",
        "beside that at which the beam is mounted",
        _source(stated=range_k is not None),
    )
