"""Worlds that only plates have: heat from one side, a spring that gives way, and contacts beyond the stated range."""

from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.plate import heated
from beamtouch_models.design.physics.structure import changed, influence
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.lab.challenge.play import Case, DrawnContacts, Make, Play, SimulatedSurface
from beamtouch_models.runtime.departures import Departures

SOFTER = 0.2
"""Part of its stiffness that a spring has lost."""
HEAT_K = 1.0
"""Difference of temperature between the faces; warmer above."""
RIM = 0.5
"""Least depth of the rim beyond the range of contacts, in mm, that is worth a case."""


def plate_cases(surface: SimulatedSurface) -> list[Case]:
    """Return the cases of a plate that its scene allows; none of a beam. None of them is stated by the scene."""
    plate = surface.world.structure
    if not isinstance(plate, Plate):
        return []
    makes: list[Make] = []
    if any(support.stiffness_n_per_mm for support in plate.support_list):
        makes.append(spring_gives_way)
    if plate.expansion_per_k is not None:
        makes += [partial(hot_above, touched=touched) for touched in (False, True)]
    if beyond_mm(surface).max() > RIM:
        makes.append(at_the_rim)
    return [Case(False, make) for make in makes]


def spring_gives_way(at: DrawnContacts) -> Play:
    """Return contacts while the spring in one support, any of them, has lost a part of its stiffness."""
    world, width_mm = at.surface.world, at.surface.scene.contact.width_mm
    plate = _plate_of(at)
    sprung = np.flatnonzero([support.stiffness_n_per_mm is not None for support in plate.support_list])
    weak = at.rng.choice(sprung, size=at.draws)
    clean = np.empty_like(at.deflection_mm)
    for support in np.unique(weak):
        factors = np.ones(len(plate.support_list))
        factors[support] -= SOFTER
        off = Departures.none(at.surface.channels).model_copy(update={"spring_stiffness": factors.tolist()})
        there = weak == support
        shapes = influence(changed(plate, off), world.sensor_mm, at.place_mm[there], width_mm)
        clean[there] = shapes * at.force_n[there, None]
    return at.settle(f"one spring {100 * SOFTER:g} % softer", clean, fault=at.perfect)


def hot_above(at: DrawnContacts, *, touched: bool) -> Play:
    """Return a plate that is warmer above than below since the last rest, with or without contacts."""
    bow_mm = HEAT_K * heated(_plate_of(at), at.surface.world.sensor_mm)
    clean = at.deflection_mm * touched + bow_mm
    truth_mm = None if touched else np.full_like(at.place_mm, np.nan)
    name = f"{HEAT_K:g} K hotter above, {'contact' if touched else 'no contact'}"
    return at.settle(name, clean, truth_mm=truth_mm, fault=at.perfect)


def at_the_rim(at: DrawnContacts) -> Play:
    """Return contacts on the rim, beyond the range that the scene states: each across one edge of it."""
    extent, beyond = at.surface.extent, beyond_mm(at.surface)
    edge = at.rng.choice(beyond.size, size=at.draws, p=beyond.ravel() / beyond.sum())
    axis, side = np.divmod(edge, 2)
    depth_mm = at.rng.uniform(0, beyond.ravel()[edge])
    place_mm, rows = at.place_mm.copy(), np.arange(at.draws)
    place_mm[rows, axis] = np.where(side == 0, extent.low_mm[axis] - depth_mm, extent.high_mm[axis] + depth_mm)
    width_mm = at.surface.scene.contact.width_mm
    clean = influence(_plate_of(at), at.surface.world.sensor_mm, place_mm, width_mm) * at.force_n[:, None]
    return replace(at, place_mm=place_mm).settle("on the rim, beyond the stated range", clean, fault=at.perfect)


def beyond_mm(surface: SimulatedSurface) -> Floats:
    """Return the depth of the rim beyond the range of contacts, below and above along each axis, (axes, 2)."""
    extent = surface.extent
    return np.column_stack([extent.low_mm, np.array(surface.scene.size_mm) - extent.high_mm])


def _plate_of(at: DrawnContacts) -> Plate:
    return cast(Plate, at.surface.world.structure)  # there is no such case of a beam
