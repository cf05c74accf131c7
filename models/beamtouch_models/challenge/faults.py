"""Faults: single sensors beyond their stated errors, and what acts on the beam without being one contact.

Those of a device on a line, which the rig plays, are in `rig.faults`.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.challenge.play import Case, Make, Play, drawn, settled
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.physics.beam import influence
from beamtouch_models.world import SensorErrors

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
"""Length of a distributed load over that of the beam."""


def fault_cases() -> list[Case]:
    """Return faults of single sensors, and loads that are not one contact."""
    makes: list[Make] = [
        stuck,
        partial(wedged, touched=False),
        partial(wedged, touched=True),
        noisy,
        partial(drifted, touched=False),
        partial(drifted, touched=True),
        *(partial(pulled, times=times) for times in PULLS),
        two_at_the_quarters,
        partial(two_contacts, apart=APART, ratio=1.0),
        partial(two_contacts, apart=APART, ratio=UNEQUAL),
        partial(two_contacts, apart=APART / 10, ratio=1.0),
        *(partial(distributed, part=part) for part in SPREAD),
    ]
    return [Case(False, make) for make in makes]


def stuck(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return contacts while one sensor shows rest, with its noise."""
    position, force = drawn(surface, draws, rng)
    one = _one(surface, draws, rng)
    clean = np.where(one, 0.0, surface.world.under(position, force))
    return _fault(surface, "one channel stuck at rest", clean, rng, one=one)


def wedged(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, touched: bool) -> Play:
    """Return a sensor that shows a deflection of its own, with or without a contact."""
    one = _one(surface, draws, rng)
    clean = one * WEDGE * surface.metadata.max_deflection_mm + _clean(surface, draws, rng, touched=touched)
    return _fault(surface, f"one channel wedged, {'contact' if touched else 'no contact'}", clean, rng, one=one)


def drifted(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, touched: bool) -> Play:
    """Return a sensor whose zero has drifted, in either direction, with or without a contact."""
    either = rng.choice([-1.0, 1.0], size=(draws, 1))
    one = _one(surface, draws, rng)
    off = replace(surface.perfect(draws), zero_mm=one * either * DRIFT * surface.metadata.noise.reading_mm)
    name = f"one channel drifted, {'contact' if touched else 'no contact'}"
    return _fault(surface, name, _clean(surface, draws, rng, touched=touched), rng, off, one)


def noisy(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return contacts while one channel is many times as noisy as stated."""
    one = _one(surface, draws, rng)
    louder = np.where(one, NOISY, 1.0)
    off, clean = replace(surface.perfect(draws), noise=louder), _clean(surface, draws, rng, touched=True)
    return replace(_fault(surface, f"one channel {NOISY:g} times as noisy", clean, rng, off, one), noisy=louder)


def pulled(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, times: float) -> Play:
    """Return forces away from the sensors."""
    position, _ = drawn(surface, draws, rng)
    force = np.full(draws, -times * surface.metadata.ranges.force_n[0])
    name = f"pull of {times:g} times the smallest force"
    return _fault(surface, name, surface.world.under(position, force), rng)


def two_contacts(
    surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, apart: float, ratio: float
) -> Play:
    """Return two contacts at once, some part of the range apart, the second with `ratio` times the force."""
    low, high = surface.metadata.ranges.position_mm
    _, force = drawn(surface, draws, rng)
    first = rng.uniform(low, high - apart * (high - low), size=draws)
    second = first + apart * (high - low)
    swapped = rng.random(draws) < 0.5
    first, second = np.where(swapped, second, first), np.where(swapped, first, second)
    shares = force / (1 + ratio), force * ratio / (1 + ratio)
    clean = surface.world.under(first, shares[0]) + surface.world.under(second, shares[1])
    name = f"two contacts {apart:g} of the range apart" + (f", 1:{ratio:g}" if ratio != 1 else "")
    return _fault(surface, name, clean, rng)


def two_at_the_quarters(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Play:
    """Return two equal contacts, each a quarter of the range from an end."""
    low, high = surface.metadata.ranges.position_mm
    force = np.full(draws, AT_THE_QUARTERS * surface.metadata.ranges.force_n[1])
    places = (np.full(draws, low + part * (high - low)) for part in (0.25, 0.75))
    clean: Floats = np.sum([surface.world.under(place, force) for place in places], axis=0)
    return _fault(surface, "two contacts at the quarters", clean, rng)


def distributed(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, part: float) -> Play:
    """Return loads that press evenly on a part of the beam."""
    width_mm = part * surface.world.beam.length_mm
    low, high = surface.metadata.ranges.position_mm
    middle = rng.uniform(min(low + width_mm / 2, (low + high) / 2), max(high - width_mm / 2, (low + high) / 2), draws)
    _, force = drawn(surface, draws, rng)
    clean = influence(surface.world.beam, surface.world.sensor_mm, middle, width_mm) * force[:, None]
    name = f"load spread over {100 * part:g} % of the beam"
    return _fault(surface, name, clean, rng)


def _fault(
    surface: SimulatedSurface,
    name: str,
    deflection_mm: Floats,
    rng: np.random.Generator,
    fault: SensorErrors | None = None,
    one: Floats | None = None,
) -> Play:
    """Return a play of a fault, on sensors that have their honest errors as well.

    `one` is 1 for the channel of each draw that is wrong, and 0 for the others.
    """
    draws = len(deflection_mm)
    honest, fault = surface.honest(draws, rng), fault or surface.perfect(draws)
    errors = replace(fault, gain=fault.gain * honest.gain, zero_mm=fault.zero_mm + honest.zero_mm)
    play = settled(surface, name, deflection_mm, errors, faulty=fault)
    return replace(play, naming=True, wrong=None if one is None else np.argmax(one, axis=1))


def _clean(surface: SimulatedSurface, draws: int, rng: np.random.Generator, *, touched: bool) -> Floats:
    position, force = drawn(surface, draws, rng)
    return surface.world.under(position, force) * touched


def _one(surface: SimulatedSurface, draws: int, rng: np.random.Generator) -> Floats:
    """Return 1 for one channel of each draw, and 0 for the others."""
    return np.eye(surface.channels)[rng.integers(surface.channels, size=draws)]
