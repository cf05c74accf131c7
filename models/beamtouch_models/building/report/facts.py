"""The data of a report beyond the metadata: error along the beam, components, and other layouts."""

from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from beamtouch_models.accuracy.evaluation import estimates
from beamtouch_models.accuracy.limit import MeanError, compare_limits, simulated
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.statistics import Measurement, mean_of
from beamtouch_models.arrays import Floats
from beamtouch_models.building.build import Built
from beamtouch_models.errors import SceneError
from beamtouch_models.loading import ModelFile, load_bytes
from beamtouch_models.placement.eigenvalue_product import Components, principal_components
from beamtouch_models.placement.layout import equal_pitch_mm
from beamtouch_models.placement.placing import Aim, Placement, place, place_by_position_error, score_positions
from beamtouch_models.pricing.prices import Effect
from beamtouch_models.scene import Scene
from beamtouch_models.sweeps import Progress

PROFILE_DRAWS = 8_192
PROFILE_BINS = 24
LAYOUT_DRAWS = 4_096
SEED_SHIFT = 5
"""The build uses its seed and the four after it; the report uses the next ones."""


@dataclass(frozen=True)
class Profile:
    """Error and interval of position along the beam, one value per stretch of equal length."""

    position_mm: Floats
    """(stretches,) middles."""
    model_mm: Floats
    """Mean |error| of the model."""
    limit_mm: Floats
    """Mean |error| of the posterior median."""
    held_in: tuple[Measurement, ...] | None
    """Share of contacts inside their interval over the whole range, in the first stretch and in the last; None if the
    model gives no interval."""
    width_mm: Floats | None
    """Mean width of the interval."""


@dataclass(frozen=True)
class OtherLayout:
    """A layout with its score and accuracy limit, for comparison."""

    name: str
    positions_mm: Floats
    log_eigenvalue_product: float
    """In the unit of `Placement.log_eigenvalue_product`."""
    limit: MeanError
    taken: bool


@dataclass(frozen=True)
class Facts:
    """Everything that the page shows."""

    scene: Scene
    model: ModelFile
    placement: Placement
    aim: Aim
    load_mm: Floats
    """(loads,)"""
    components: Components
    """Principal components of the influence matrix of the layout, in mm/N."""
    profile: Profile
    layouts: tuple[OtherLayout, ...]
    effects: tuple[Effect, ...]
    """Physical effects with their prices."""

    @property
    def middle_force_n(self) -> float:
        """Middle of the force range."""
        low, high = self.scene.contact.force_range_n
        return (low + high) / 2


def gather(scene: Scene, built: Built, progress: Progress) -> Facts:
    """Measure the data of the report, which takes seconds; the same build gives the same data."""
    progress("measuring for the report", 0.97)
    positions, surface = np.array(built.placement.positions_mm), built.surface
    model = load_bytes(built.content, "the model just built")
    seed = built.metadata.seed
    return Facts(
        scene,
        model,
        built.placement,
        built.aim,
        surface.influence.load_mm,
        principal_components(surface.influence.matrix(positions)),
        _profile(surface.prior(positions), model, seed),
        _layouts(built),
        surface.effects,
    )


def _profile(prior: Prior, model: ModelFile, seed: int) -> Profile:
    contacts = simulated(prior, PROFILE_DRAWS, seed + SEED_SHIFT)
    weight = np.broadcast_to(contacts.drawn.weight[:, None], contacts.likely_mm.shape)
    answers = estimates(model, prior, contacts.drawn.deflection_mm)
    edges = np.linspace(*prior.position_mm, PROFILE_BINS + 1)
    stretch = np.clip(np.searchsorted(edges, contacts.likely_mm, side="right") - 1, 0, PROFILE_BINS - 1)

    def means(values: Floats) -> Floats:
        whole = np.bincount(stretch.ravel(), (weight * values).ravel(), PROFILE_BINS)
        return whole / np.bincount(stretch.ravel(), weight.ravel(), PROFILE_BINS)

    held_in = width_mm = None
    if "position_low_mm" in answers:
        low, high = answers["position_low_mm"], answers["position_high_mm"]
        inside = contacts.held(low, high)
        width_mm = means(np.broadcast_to((high - low)[:, None], inside.shape))
        ends = (np.True_, stretch == 0, stretch == PROFILE_BINS - 1)
        held_in = tuple(mean_of(inside.astype(np.float64), weight * end) for end in ends)
    model_mm = means(contacts.error_mm(answers["position_mm"]))
    limit_mm = means(contacts.least_error_mm())
    return Profile((edges[1:] + edges[:-1]) / 2, model_mm, limit_mm, held_in, width_mm)


def _layouts(built: Built) -> tuple[OtherLayout, ...]:
    """Compare the model's layout with others, all on the same contacts."""
    influence, rules, errors = built.surface.influence, built.surface.rules, built.surface.errors
    taken, seed, found_by = np.array(built.placement.positions_mm), built.metadata.seed, built.aim.criterion
    named = {"equal pitch": equal_pitch_mm(influence.length_mm, len(taken))}
    # A layout that was kept, not searched, may be another one than its criterion finds now.
    searched = built.placement.evaluations > 0 and not built.aim.spare
    # The rules may leave too few independent readings; only the product needs as many as there are sensors.
    with suppress(SceneError):
        named["eigenvalue product"] = (
            taken
            if searched and found_by == "eigenvalue-product"
            else np.array(place(influence, rules, len(taken), seed).positions_mm)
        )
    named["position error"] = (
        taken
        if searched and found_by == "position-error"
        else np.array(place_by_position_error(influence, rules, len(taken), seed, errors).positions_mm)
    )
    if not any(np.allclose(taken, positions) for positions in named.values()):
        named["the model's"] = taken
    priors = [built.surface.prior(positions) for positions in named.values()]
    limits = compare_limits(built.surface.prior(taken), priors, LAYOUT_DRAWS, seed + SEED_SHIFT + 1)
    return tuple(
        OtherLayout(
            name, positions, score_positions(influence, positions), one.limit, bool(np.allclose(taken, positions))
        )
        for (name, positions), one in zip(named.items(), limits, strict=True)
    )
