"""Errors of all sensors, faults of single ones beyond their stated errors, and loads that are not one contact.

Faults of a device on a line, which the rig plays, are in `rig.faults`.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.structure import influence, size_of
from beamtouch_models.design.world import SensorErrors
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Make, Play, SimulatedSurface
from beamtouch_models.places import as_stated

WEDGE = 0.22
"""Deflection that a wedge shows, over the largest; 0.5 mm on the bench."""
DRIFT = 10.0
"""Drift of one zero over the noise of a reading; 0.045 mm on the bench."""
NOISY = 10.0
PULLS = (0.25, 1.0)
"""Force of a pull over the smallest force; 0.5 N and 2 N on the bench."""
APART = 0.5
"""Distance of two contacts over the range of contacts; near ones are a tenth of it apart."""
AT_THE_QUARTERS = 0.4
"""Force of two contacts over the largest force; 8 N on the bench."""
UNEQUAL = 4.0
SPREAD = (0.1, 0.25, 0.5)
"""Length of a distributed load over that of the beam; on a plate, side of a square over the shorter side."""


def fault_cases() -> list[Case]:
    """Return faults of single sensors, and loads that are not one contact."""
    makes: list[Make] = [
        stuck,
        *(partial(wedged, touched=touched) for touched in (False, True)),
        noisy,
        *(partial(drifted, touched=touched) for touched in (False, True)),
        *(partial(pulled, times=times) for times in PULLS),
        two_at_the_quarters,
        partial(two_contacts, apart=APART, ratio=1.0),
        partial(two_contacts, apart=APART, ratio=UNEQUAL),
        partial(two_contacts, apart=APART / 10, ratio=1.0),
        *(partial(distributed, part=part) for part in SPREAD),
    ]
    return [Case(False, make) for make in makes]


def _fault(at: DrawnContacts, name: str, deflection_mm: Floats, fault: SensorErrors | None = None) -> Play:
    """Return a play of a fault, on sensors that have their honest errors as well."""
    fault = fault or at.perfect
    errors = replace(fault, gain=fault.gain * at.honest.gain, zero_mm=fault.zero_mm + at.honest.zero_mm)
    return at.settle(name, deflection_mm, errors, truth_mm=np.full_like(at.place_mm, np.nan), fault=fault)


def _words(*, touched: bool) -> str:
    return "contact" if touched else "no contact"


def stuck(at: DrawnContacts) -> Play:
    """Return contacts while one sensor shows rest, with its noise."""
    return _fault(at, "one channel stuck at rest", np.where(at.one, 0.0, at.deflection_mm))


def wedged(at: DrawnContacts, *, touched: bool) -> Play:
    """Return a sensor that shows a deflection of its own, with or without a contact."""
    wedge_mm = WEDGE * at.surface.metadata.max_deflection_mm * at.one
    return _fault(at, f"one channel wedged, {_words(touched=touched)}", at.deflection_mm * touched + wedge_mm)


def drifted(at: DrawnContacts, *, touched: bool) -> Play:
    """Return a sensor whose zero has drifted, in either direction, with or without a contact."""
    either = at.rng.choice([-1.0, 1.0], size=(at.draws, 1))
    off = replace(at.perfect, zero_mm=at.one * either * DRIFT * at.surface.metadata.noise.reading_mm)
    return _fault(at, f"one channel drifted, {_words(touched=touched)}", at.deflection_mm * touched, off)


def noisy(at: DrawnContacts) -> Play:
    """Return contacts while one channel is many times as noisy as stated."""
    louder = replace(at.perfect, noise=1 + (NOISY - 1) * at.one)
    return _fault(at, f"one channel {NOISY:g} times as noisy", at.deflection_mm, louder)


def pulled(at: DrawnContacts, *, times: float) -> Play:
    """Return forces away from the sensors."""
    force = np.full(at.draws, -times * at.surface.metadata.ranges.force_n[0])
    return _fault(at, f"pull of {times:g} times the smallest force", at.surface.under(at.place_mm, force))


def two_contacts(at: DrawnContacts, *, apart: float, ratio: float) -> Play:
    """Return two contacts at once, some part of the range apart, the second with `ratio` times the force.

    On a plate, one lies in any direction from the other.
    """
    extent = at.surface.extent
    way = apart * extent.size_mm * at.directions()
    first = at.rng.uniform(extent.low_mm, extent.high_mm - way, size=at.place_mm.shape)
    second = first + way
    swapped = at.rng.random((at.draws, 1)) < 0.5
    first, second = np.where(swapped, second, first), np.where(swapped, first, second)
    for axis in range(1, extent.axes):
        mirrored = at.rng.random(at.draws) < 0.5
        for place in (first, second):
            place[mirrored, axis] = extent.low_mm[axis] + extent.high_mm[axis] - place[mirrored, axis]
    share = at.force_n / (1 + ratio)
    clean = at.surface.under(first, share) + at.surface.under(second, ratio * share)
    name = f"two contacts {apart:g} of the range apart" + (f", 1:{ratio:g}" if ratio != 1 else "")
    return _fault(at, name, clean)


def two_at_the_quarters(at: DrawnContacts) -> Play:
    """Return two equal contacts, each a quarter of the range from an end; on a plate, along each axis."""
    force_n = AT_THE_QUARTERS * at.surface.metadata.ranges.force_n[1]
    places = at.surface.extent.at(np.array([[0.25], [0.75]]))
    deflection_mm = at.surface.under(places, np.full(2, force_n)).sum(axis=0)
    return _fault(at, "two contacts at the quarters", np.tile(deflection_mm, (at.draws, 1)))


def distributed(at: DrawnContacts, *, part: float) -> Play:
    """Return loads that press evenly on a part of the beam, or on a square of a plate."""
    world, extent = at.surface.world, at.surface.extent
    width_mm = part * min(size_of(world.structure))
    margin_mm = np.minimum(width_mm, extent.size_mm) / 2
    middle = at.rng.uniform(extent.low_mm + margin_mm, extent.high_mm - margin_mm, at.place_mm.shape)
    clean = influence(world.structure, world.sensor_mm, as_stated(middle), width_mm) * at.force_n[:, None]
    where = "the beam" if extent.axes == 1 else "the shorter side, both ways"
    return _fault(at, f"load spread over {100 * part:g} % of {where}", clean)


GAINS_PERCENT = (0.3, 1.0, 3.0)
ZEROS = (0.2, 1.0, 3.0, 10.0)
"""Zeros over the noise of a reading."""
OFF_MM = 1.0
"""Standard deviation of the positions of the sensors."""


def error_cases(surface: SimulatedSurface) -> list[Case]:
    """Return contacts with errors of all sensors; honest where they are within what the model states."""
    gain, zero_mm = float(surface.gain.min()), float(surface.zero_mm.min())
    noise_mm = surface.metadata.noise.reading_mm
    cases = [Case(percent / 100 <= gain + 1e-9, partial(gains_off, percent=percent)) for percent in GAINS_PERCENT]
    cases += [Case(noises * noise_mm <= zero_mm + 1e-9, partial(zeros_off, noises=noises)) for noises in ZEROS]
    if not surface.scene.is_computed:  # what the sensors show was measured where they stand
        return cases
    return [*cases, Case(surface.scene.sensors.mounting_tolerance_mm >= OFF_MM, places_off)]


def gains_off(at: DrawnContacts, *, percent: float) -> Play:
    """Return contacts measured with gains that are off by some percent, as a standard deviation."""
    off = 1 + percent / 100 * _normal(at)
    errors, fault = replace(at.honest, gain=off), replace(at.perfect, gain=off)
    return at.settle(f"gains {percent:g} % off", errors=errors, fault=fault)


def zeros_off(at: DrawnContacts, *, noises: float) -> Play:
    """Return contacts measured with zeros that are off by some noises of a reading, as a standard deviation."""
    off_mm = noises * at.surface.metadata.noise.reading_mm * _normal(at)
    errors, fault = replace(at.honest, zero_mm=off_mm), replace(at.perfect, zero_mm=off_mm)
    return at.settle(f"zeros {noises:g} noises off", errors=errors, fault=fault)


def _normal(at: DrawnContacts) -> Floats:
    """Return a standard normal number for each channel of each draw."""
    return at.rng.normal(size=at.honest.gain.shape)


def places_off(at: DrawnContacts) -> Play:
    """Return contacts on sensors that are mounted beside their positions."""
    world, width_mm = at.surface.world, at.surface.scene.contact.width_mm
    off_mm, size_mm = OFF_MM * at.rng.normal(size=(at.draws, *world.sensor_mm.shape)), size_of(world.structure)
    sensors_mm = np.clip(world.sensor_mm + off_mm, 0.0, size_mm if len(size_mm) > 1 else size_mm[0])
    contacts = zip(sensors_mm, as_stated(at.place_mm[:, None]), at.force_n, strict=True)
    clean = np.array([force * influence(world.structure, own, place, width_mm)[0] for own, place, force in contacts])
    return at.settle(f"positions {OFF_MM:g} mm off", clean, fault=at.perfect)
