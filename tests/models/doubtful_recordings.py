"""Recordings of known loads in which something is wrong that `calibrate` must name, or fit."""

from dataclasses import replace

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.recordings import Loads
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.metadata import Metadata
from support.surfaces.real_surfaces import SESSION_MIN, recorded, true_prior, with_mistake

HANGER, SHIFT, BEND, MISTYPED = 0.1, 0.02, 0.15, "40 mm"
"""Weight of the hanger over the mean force, shift of all loads over the length, bend of a curved sensor at its largest
deflection, and a mistyped place."""
WRONG = ("none", "curved sensor", "drift", "hanger", "shift", "mistyped load")


def doubtful(
    metadata: Metadata, real: Imperfections, wrong: str, rng: np.random.Generator, hand_mm: float = 0.3
) -> tuple[Loads, str]:
    """Return ten loads of two forces with something wrong, and how the words that refuse it begin; empty if none do."""
    plain = recorded(metadata, real, rng)
    low, high = metadata.ranges.position_mm
    count = len(plain.number)
    stated_n = np.where(np.arange(count) % 2, plain.force_n, plain.force_n / 2)
    at_mm = np.clip(plain.place_mm[:, 0] + hand_mm * rng.normal(size=count), low, high)
    pressed_n = stated_n * (1 + 0.01 * hand_mm * rng.normal(size=count))
    if wrong == "hanger":
        pressed_n = pressed_n + HANGER * stated_n.mean()
    if wrong == "shift":
        at_mm = np.clip(at_mm + SHIFT * metadata.length_mm, low, high)
    prior = true_prior(metadata, real)
    measured_mm = prior.measured(pressed_n[:, None] * prior.influence_at(on_axis(at_mm)))
    named = ""
    if wrong == "curved sensor":
        channel = int(rng.integers(measured_mm.shape[1]))
        measured_mm[:, channel] = bent_mm(measured_mm[:, channel], BEND * rng.choice([-1, 1]))
        named = f"s{channel + 1} does not fit"
    if wrong == "drift":
        rate = metadata.floor.drift_mm_per_min * (rng.normal() + 0.5 * rng.normal(size=measured_mm.shape[1]))
        measured_mm = measured_mm + np.linspace(0.0, SESSION_MIN, count)[:, None] * rate
    noisy_mm = measured_mm + plain.deviation_mm * rng.normal(size=measured_mm.shape)
    loads = replace(plain, force_n=stated_n, measured_mm=noisy_mm)
    if wrong == "mistyped load":
        place_mm, force_n, row = with_mistake(MISTYPED, loads, metadata.ranges.position_mm, rng)
        loads, named = replace(loads, place_mm=place_mm, force_n=force_n), f"load {loads.number[row]} ("
    return loads, named


def bent_mm(deflection_mm: Floats, bend: float) -> Floats:
    """Return what a curved sensor shows that is described as straight, with a relative bend at its largest."""
    bent: Floats = deflection_mm * (1 + bend * deflection_mm / np.abs(deflection_mm).max())
    return bent
