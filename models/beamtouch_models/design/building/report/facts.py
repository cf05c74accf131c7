"""What the report of a build shows: the error along the beam or over the plate, and other layouts, measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from beamtouch_common.outline import axes_of, names_of
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.evaluation import estimates
from beamtouch_models.design.accuracy.limit import Contacts, compare_limits, limits_without, simulated
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement, mean_of
from beamtouch_models.design.building.build import Built
from beamtouch_models.design.building.compared import Compared, compare_layout
from beamtouch_models.design.building.report.plate_pictures import Region
from beamtouch_models.design.building.report.questions import TRIED
from beamtouch_models.design.placement.placing import DEFAULT_AIM, score_layout
from beamtouch_models.design.placement.reasons import Costs
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.places import Extent, grid_of, in_rows
from beamtouch_models.runtime.error_model import NORMAL_975
from beamtouch_models.runtime.loading import ModelFile, load_bytes
from beamtouch_models.runtime.metadata import CORRELATION_OUTPUT
from beamtouch_models.runtime.session import stated_mm

PROFILE_DRAWS, LAYOUT_DRAWS, PAIR_DRAWS, LEAST_DRAWS = 8_192, 4_096, 1_024, 256
"""Usual numbers of simulated contacts, and the smallest."""
TRIALS = 20_000
"""Simulated acceptances."""
PROFILE_BINS, PLATE_BINS = 24, 8
"""Stretches of a beam, and parts of a plate along its longer side."""
MIDDLE, RIM, CORNER = 0.5, 0.9, 0.8
"""Of a plate, shares of the range of each axis: of its middle, of all but its rim, and of all but its corners."""
SEED_SHIFT = 5
"""The build uses its seed and the four after it; the report uses the next ones."""


@dataclass(frozen=True)
class Part:
    """Error and interval of position in a part of the extent of contacts."""

    name: str
    error_mm: Measurement
    """Mean |error| of the model."""
    held: tuple[Measurement, ...]
    """(axes,), share of contacts inside their interval; empty if the model gives no interval."""
    interval_mm: tuple[Measurement, ...]
    """(axes,), mean length of the interval."""


@dataclass(frozen=True)
class Profile:
    """Error and interval of position along the beam or over the plate."""

    edges_mm: tuple[Floats, ...]
    """(axes,), edges of parts of equal length along each axis."""
    model_mm: Floats
    """(parts,) mean |error| of the model, in the order of `grid_of`."""
    limit_mm: Floats
    """(parts,) mean |error| of the posterior median."""
    whole: Part
    middle: Part
    """The middle third of a beam's range, the middle half of each axis of a plate's."""
    first: Part
    """The first stretch, at the left end of the range; of a plate, its rim."""
    last: Part
    """The last stretch; of a plate, its corners."""
    force_n: Measurement | None
    """Mean |error| of force; None if the model states none."""
    accepted_mm: float
    """Bound that the mean |error| of `TRIED` contacts exceeds in one of twenty trials."""
    regions: tuple[Region, ...]
    """What answers at a few places of a plate hold by 95 %; none of a beam."""

    @property
    def position_mm(self) -> Floats:
        """(stretches,) middles of the stretches of a beam."""
        (edges,) = self.edges_mm
        return (edges[1:] + edges[:-1]) / 2


@dataclass(frozen=True)
class OtherLayout:
    """A layout with its score and accuracy limit, for comparison."""

    name: str
    positions_mm: Floats
    """(sensors,) on a beam, (sensors, 2) on a plate."""
    log_eigenvalue_product: float
    """In the unit of `Placement.log_eigenvalue_product`."""
    limit: Measurement
    """In percent of the length, or of the diagonal of a plate."""
    costs: Costs


@dataclass(frozen=True)
class TwoFailed:
    """The two sensors whose failure together costs most."""

    names: tuple[str, str]
    limit: Measurement
    """In percent of the length, or of the diagonal of a plate."""


@dataclass(frozen=True)
class Facts:
    """Everything that the page shows."""

    scene: Scene
    built: Built
    model: ModelFile
    profile: Profile
    layouts: tuple[OtherLayout, ...]
    """The model's first."""
    compared: Compared
    two_failed: TwoFailed | None


def gather(built: Built, progress: Progress) -> Facts:
    """Measure the data of the report, which takes seconds; the same build gives the same data."""
    progress("measuring for the report", 0.97)
    model = load_bytes(built.content, "the model just built")
    profile = _profile(built.layout.prior, model, built)
    return Facts(built.layout.surface.scene, built, model, profile, *_layouts(built), _two_failed(built))


def _profile(prior: Prior, model: ModelFile, built: Built) -> Profile:
    draws, seed = built.layout.aim.effort.of(PROFILE_DRAWS, LEAST_DRAWS), built.metadata.seed + SEED_SHIFT
    contacts = simulated(prior, draws, seed)
    answers = estimates(model, prior, contacts.drawn.deflection_mm)
    return profile_of(contacts, answers, prior.extent, seed, () if prior.extent.axes == 1 else regions_of(prior, model))


def profile_of(
    contacts: Contacts, answers: Mapping[str, Floats], extent: Extent, seed: int, regions: tuple[Region, ...] = ()
) -> Profile:
    """Return the errors and intervals of a model's answers to contacts, part by part; `seed` is that of the trials."""
    weight, axes = np.broadcast_to(contacts.drawn.weight[:, None], contacts.likely_mm.shape[:2]), axes_of(extent.axes)
    edges = edges_of(extent, PROFILE_BINS if extent.axes == 1 else PLATE_BINS)
    at = [
        np.clip(np.searchsorted(ends, places, side="right") - 1, 0, len(ends) - 2)
        for ends, places in zip(edges, np.moveaxis(contacts.likely_mm, -1, 0), strict=True)
    ]
    counts = [len(ends) - 1 for ends in edges]
    cell = np.ravel_multi_index(at, counts).ravel()

    def means(values: Floats) -> Floats:
        total, weights = (
            np.bincount(cell, (weight * values).ravel(), np.prod(counts)),
            np.bincount(cell, weight.ravel(), np.prod(counts)),
        )
        with np.errstate(invalid="ignore"):  # a part without contacts has no mean
            mean: Floats = total / weights
        return mean

    error_mm, inside, lengths_mm = contacts.error_mm(stated_mm(answers, axes)), None, None
    if names_of(axes[0], "mm")[1] in answers:
        low, high = (stated_mm(answers, axes, end) for end in (1, 2))
        inside, lengths_mm = contacts.held(low, high).astype(np.float64), high - low

    def part(name: str, among: Bools | np.bool_) -> Part:
        own = weight * among
        if inside is None or lengths_mm is None:
            return Part(name, mean_of(error_mm, own), (), ())
        held = tuple(mean_of(inside[..., axis], own) for axis in range(extent.axes))
        long = (np.broadcast_to(length[:, None], own.shape) for length in lengths_mm.T)
        return Part(name, mean_of(error_mm, own), held, tuple(mean_of(values, own) for values in long))

    if extent.axes == 1:
        (stretch,), (ends,), third = at, edges, PROFILE_BINS // 3
        parts = (
            part("middle third", (third <= stretch) & (stretch < 2 * third)),
            part(f"left end, to {ends[1]:.0f} mm", stretch == 0),
            part(f"right end, from {ends[-2]:.0f} mm", stretch == PROFILE_BINS - 1),
        )
    else:
        away = np.abs((contacts.likely_mm - extent.low_mm) / extent.size_mm * 2 - 1)
        parts = (
            part("middle half along each axis", np.all(away < MIDDLE, axis=2)),
            part("rim, the outer 5 % at each edge", np.any(away > RIM, axis=2)),
            part("corners, the outer 10 % along both axes", np.all(away > CORNER, axis=2)),
        )
    return Profile(
        tuple(edges),
        means(error_mm),
        means(contacts.least_error_mm()),
        part("whole range", np.True_),
        *parts,
        None
        if "force_n" not in answers
        else mean_of(np.abs(answers["force_n"] - contacts.drawn.force_n), contacts.drawn.weight),
        _accepted_mm(error_mm, weight, seed),
        regions,
    )


def edges_of(extent: Extent, most: int) -> list[Floats]:
    """Return the edges of parts of equal length, `most` along the longest axis and as long along the others."""
    size = extent.size_mm
    counts = np.maximum(1, np.round(most * size / size.max())).astype(int)
    return [np.linspace(*ends, count + 1) for ends, count in zip(extent.ranges_mm, counts, strict=True)]


def regions_of(prior: Prior, model: ModelFile) -> tuple[Region, ...]:
    """Return the regions of answers to contacts without noise: the weakest and the strongest at nine places."""
    extent, forces = prior.extent, sorted(set(prior.force_n))
    share = np.array([0.1, 0.5, 0.9])
    places = np.repeat(extent.at(grid_of([share, share])), len(forces), axis=0)
    force_n = np.tile(forces, len(places) // len(forces))
    answers = estimates(model, prior, prior.sampled(places, force_n)[0])
    low, high = (stated_mm(answers, prior.axes, end) for end in (1, 2))
    deviation_mm, correlation = (high - low) / (2 * NORMAL_975), answers[CORRELATION_OUTPUT]
    return tuple(
        Region((place[0], place[1]), force, (deviation[0], deviation[1]), float(r))
        for place, force, deviation, r in zip(
            places.tolist(), force_n.tolist(), deviation_mm.tolist(), correlation, strict=True
        )
    )


def _accepted_mm(error_mm: Floats, weight: Floats, seed: int) -> float:
    """Return the largest mean of `TRIED` errors that honest trials keep in 19 of 20, from errors of any shape."""
    rng = np.random.default_rng(seed)
    drawn = rng.choice(error_mm.ravel(), size=(TRIALS, TRIED), p=weight.ravel() / weight.sum())
    return float(np.quantile(drawn.mean(axis=1), 0.95))


def _two_failed(built: Built) -> TwoFailed | None:
    """Measure the worst failure of two sensors; None if the model needs all sensors but one."""
    metadata, prior = built.metadata, built.layout.prior
    if len(metadata.layout) - metadata.min_channels < 2:
        return None
    pairs = list(combinations(range(prior.channels), 2))
    draws = built.layout.aim.effort.of(PAIR_DRAWS, LEAST_DRAWS)
    compared = list(limits_without(prior, pairs, draws, metadata.seed + SEED_SHIFT + 2))
    worst = int(np.argmax([each.ratio.value for each in compared]))
    first, second = (metadata.layout[index].name for index in pairs[worst])
    return TwoFailed((first, second), compared[worst].ratio.scaled(metadata.accuracy.limit_percent))


def _layouts(built: Built) -> tuple[tuple[OtherLayout, ...], Compared]:
    """Compare the model's layout with others, all on the same contacts."""
    surface, aim, seed = built.layout.surface, built.layout.aim, built.metadata.seed
    # A layout that was kept, not searched, or by another criterion, is shown beside that which would be placed now.
    anew = aim.criterion != DEFAULT_AIM.criterion or not built.layout.placement.evaluations
    compared = compare_layout(built.layout, seed, anew=anew)
    priors = [surface.prior(positions) for positions in compared.positions_mm.values()]
    draws = aim.effort.of(LAYOUT_DRAWS, LEAST_DRAWS)
    limits = compare_limits(built.layout.prior, priors, draws, seed + SEED_SHIFT + 1)
    places = [in_rows(positions, surface.rules.axes) for positions in compared.positions_mm.values()]
    scores = [score_layout(surface.influence, each) for each in places]
    layouts = [
        OtherLayout(name, positions, score, each.limit, costs)
        for (name, positions), score, each, costs in zip(
            compared.positions_mm.items(), scores, limits, compared.costs.values(), strict=True
        )
    ]
    return tuple(layouts), compared
