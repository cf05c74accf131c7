"""Contacts of unknown place and force on surfaces that differ from their scenes, as the service keeps them."""

from dataclasses import dataclass

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.calibration.nominal_surface import NominalSurface
from beamtouch_models.design.calibration.recordings import UnlabelledContacts
from beamtouch_models.design.calibration.self_calibrate import SelfFit, self_fit
from beamtouch_models.design.calibration.unlabelled import locate
from beamtouch_models.design.sweeps import silent
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import ModelFile
from beamtouch_models.runtime.metadata import Metadata
from support.surfaces.real_surfaces import true_prior


@dataclass(frozen=True)
class Kind:
    """Deviations of a surface from its scene, and of its events from contacts anywhere."""

    gain: float = 0.02
    position_mm: float = 0.0
    two_at_once: float = 0.0
    """Share of the contacts with another one beside them."""
    fixity: tuple[float, float] = (0.0, 0.0)
    curve: float = 0.0
    """Relative bend of the characteristic at full travel."""
    places_mm: tuple[float, ...] = ()
    """Where the contacts are; anywhere by default."""
    readings: int | None = None
    """Readings in each; as many as the filter has by default."""


OFF = Kind(position_mm=1.0)
"""Gains 2 % and sensors 1 mm off."""


def surface(metadata: Metadata, kind: Kind, rng: np.random.Generator) -> Imperfections:
    """Draw a surface."""
    layout_mm = np.array([channel.position_mm for channel in metadata.layout])
    gain, moved = 1 + kind.gain * rng.normal(size=len(layout_mm)), kind.position_mm * rng.normal(size=len(layout_mm))
    return Imperfections(
        gain=tuple(np.clip(gain, 0.8, 1.2).tolist()),
        position_offset_mm=tuple((np.clip(layout_mm + moved, 0, metadata.length_mm) - layout_mm).tolist()),
        fixity=kind.fixity,
        curve_per_mm=kind.curve / metadata.max_deflection_mm,
    )


def drawn(
    metadata: Metadata, real: Imperfections, kind: Kind, rng: np.random.Generator, count: int
) -> UnlabelledContacts:
    """Draw contacts over the ranges of the scene."""
    prior = true_prior(metadata, real)
    position, force = rng.uniform(*prior.extent.range_mm, count), rng.uniform(*prior.force_n, count)
    if kind.places_mm:
        position = rng.choice(kind.places_mm, count) + rng.normal(size=count)
    deflection = force[:, None] * prior.influence_at(on_axis(position))
    beside = _anywhere(prior, rng, count)
    deflection = deflection + np.where(rng.random((count, 1)) < kind.two_at_once, beside, 0.0)
    deviation = metadata.noise.reading_mm / np.sqrt(kind.readings or metadata.filter.window)
    measured = prior.measured(deflection) + deviation * rng.normal(size=deflection.shape)
    return UnlabelledContacts(measured, np.full(measured.shape, deviation))


def random_contacts(
    model: ModelFile, kind: Kind, seed: int, count: int = 200
) -> tuple[UnlabelledContacts, Imperfections]:
    """Draw contacts of a random surface."""
    real = surface(model.metadata, kind, np.random.default_rng([seed, 7]))
    return drawn(model.metadata, real, kind, np.random.default_rng([seed, 11]), count), real


def fitted(model: ModelFile, kind: Kind, seed: int, count: int = 200) -> tuple[SelfFit, Imperfections]:
    """Fit contacts of a random surface."""
    contacts, real = random_contacts(model, kind, seed, count)
    return self_fit(model, contacts, silent), real


def _anywhere(prior: Prior, rng: np.random.Generator, count: int) -> Floats:
    force = rng.uniform(*prior.force_n, (count, 1))
    deflection: Floats = force * prior.influence_at(prior.extent.uniform(count, rng))
    return deflection


def missed_mm(nominal: NominalSurface, vector: Floats, metadata: Metadata, real: Imperfections) -> float:
    """Mean distance of contacts without noise from where a surface with fitted departures places them."""
    prior = true_prior(metadata, real)
    low, high = prior.extent.range_mm
    margin = 0.05 * (high - low)
    position = np.linspace(low + margin, high - margin, 60)
    measured = prior.measured(np.mean(prior.force_n) * prior.influence_at(on_axis(position)))
    contacts = UnlabelledContacts(measured, np.full(measured.shape, metadata.noise.sample_mm))
    found = locate(nominal, vector, contacts, np.zeros(prior.channels))
    return float(np.abs(found.place_mm[:, 0] - position).mean())
