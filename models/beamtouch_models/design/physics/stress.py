"""The largest bending stress in a beam under a force that presses anywhere in a range.

Bending alone leaves the stress E t |w''| / 2 at the surface of a section of thickness t (Gere & Goodno, Mechanics of
Materials, sec. 5.5). Between supports, steps of the section and the force, the curvature w'' is linear along the beam
(nearly so on an elastic foundation). So it is taken inside each such stretch, as a second difference of the deflection,
and followed to both ends. Shear, notches and holes are left out.
"""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.beam import influence
from beamtouch_models.design.scene.beam import Beam

LOADS, MOST_LOADS = 16, 256
"""Places of the force in each stretch between supports and steps. The largest moment is low by some 0.5 % at most. On a
foundation, there are more of them, up to the second number."""
DECAY = 0.1
"""On a foundation, the places are as far apart as this part of the length in which a deflection decays."""
SHORTEST = 1e-4
"""Shorter stretches, in parts of the length, are taken with their neighbours: differences in them would cancel."""
INSIDE, STEP = (0.25, 0.75), 0.125
"""Where the curvature of a stretch is taken, and the step of its differences, in parts of the stretch."""


def largest_stress_mpa(beam: Beam, force_n: float, range_mm: tuple[float, float]) -> float | None:
    """Return the largest stress in MPa; None if the thickness of a section is not stated.

    Raises
    ------
    SceneError
        The beam cannot be computed.
    """
    surfaces = []
    for section in beam.sections:
        if section.area_mm2 is None or section.thickness_mm is None:
            return None
        surfaces.append(6 * section.rigidity_n_mm2 / (section.area_mm2 * section.thickness_mm))
    section_ends_mm = [section.to_mm for section in beam.sections]
    shortest_mm = SHORTEST * beam.length_mm
    bounds_mm = np.unique([0.0, beam.length_mm, *beam.held_mm, *section_ends_mm])
    decay_mm = np.inf
    if beam.foundation_n_mm2:
        softest = min(section.rigidity_n_mm2 for section in beam.sections)
        decay_mm = (4 * softest / beam.foundation_n_mm2) ** 0.25
    loads_mm = _loads_mm(bounds_mm, range_mm, DECAY * decay_mm)
    stretches = np.array(_apart([*bounds_mm, *loads_mm], shortest_mm))
    left_mm, width_mm = stretches[:-1], np.diff(stretches)
    slender = beam.model_copy(update={"shear_modulus_gpa": None})
    steps_mm = width_mm[:, None, None] * (np.array(INSIDE)[:, None] + STEP * np.array([-1.0, 0.0, 1.0]))
    deflection = influence(slender, (left_mm[:, None, None] + steps_mm).ravel(), loads_mm)
    differences = np.diff(deflection.reshape(len(loads_mm), len(width_mm), 2, 3), n=2)[..., 0]
    curvature = differences / (STEP * width_mm[:, None]) ** 2
    beyond = INSIDE[0] / (INSIDE[1] - INSIDE[0])
    first, last = curvature[..., 0], curvature[..., 1]
    ends = np.stack([first + beyond * (first - last), last + beyond * (last - first)])
    section_at = np.searchsorted(section_ends_mm, left_mm + width_mm / 2)
    return force_n * float(np.abs(ends * np.array(surfaces)[section_at]).max())


def _loads_mm(bounds_mm: Floats, range_mm: tuple[float, float], apart_mm: float) -> Floats:
    """Return the places of the force: both ends of the range, and some in each stretch between the bounds in it."""
    stretches = list(pairwise(np.unique(np.clip(bounds_mm, *range_mm)).tolist()))
    counts = [min(max(LOADS, math.ceil((end - begin) / apart_mm)), MOST_LOADS) for begin, end in stretches]
    each = [np.linspace(*ends, count + 1) for ends, count in zip(stretches, counts, strict=True)]
    return np.unique(np.concatenate(each))


def _apart(places_mm: Sequence[float], shortest_mm: float) -> list[float]:
    """Return places in order, without those that are too near to one that is named before them."""
    kept: list[float] = []
    for place in places_mm:
        if all(abs(place - other) > shortest_mm for other in kept):
            kept.append(place)
    return sorted(kept)
