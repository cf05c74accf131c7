"""The report of a build as one HTML page: no script, no request, readable on light and dark screens and on paper.

Beyond what the build measured, it shows the error along the beam or over the plate, components, and other layouts.
"""

import re
from dataclasses import dataclass
from importlib.resources import files
from itertools import combinations

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape

from beamtouch_common.digits import digits
from beamtouch_common.outline import names_of
from beamtouch_common.units import fine_unit
from beamtouch_models.arrays import Bools, Floats
from beamtouch_models.design.accuracy.evaluation import estimates
from beamtouch_models.design.accuracy.limit import compare_limits, limits_without, simulated
from beamtouch_models.design.accuracy.prior import Prior
from beamtouch_models.design.accuracy.statistics import Measurement, mean_of
from beamtouch_models.design.building.build import Built
from beamtouch_models.design.building.compared import Compared, compare_layout
from beamtouch_models.design.building.remarks import weak_spot
from beamtouch_models.design.building.report.beam_drawing import beam_drawing
from beamtouch_models.design.building.report.parts import PLACE_HEADS, parts_of, places_of, supports_in_words
from beamtouch_models.design.building.report.plate_pictures import (
    Map,
    Region,
    draw_maps,
    draw_regions,
    plate_drawing,
)
from beamtouch_models.design.building.report.questions import TRIED, can, cannot, noun_of, questions
from beamtouch_models.design.charts import STYLE, Chart, Series, draw
from beamtouch_models.design.placement.eigenvalue_product import principal_components
from beamtouch_models.design.placement.placing import DEFAULT_AIM, score_layout
from beamtouch_models.design.placement.reasons import Costs
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, VERDICTS
from beamtouch_models.design.pricing.ringing import describe_ringing
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.numbers import rounded, with_error
from beamtouch_models.places import grid_of, in_rows, in_words, positions_of
from beamtouch_models.runtime.description import SOUGHT, extremes, nothing_seen, per_day, unseen
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
FINE_BINS = 28
"""Parts along the longer side of a picture without numbers."""
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
    draws = built.layout.aim.effort.of(PROFILE_DRAWS, LEAST_DRAWS)
    contacts = simulated(prior, draws, built.metadata.seed + SEED_SHIFT)
    weight = np.broadcast_to(contacts.drawn.weight[:, None], contacts.likely_mm.shape[:2])
    answers, extent = estimates(model, prior, contacts.drawn.deflection_mm), prior.extent
    edges = _edges_of(prior, PROFILE_BINS if extent.axes == 1 else PLATE_BINS)
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
        mean: Floats = np.divide(total, weights, out=np.full(len(total), np.nan), where=weights > 0)
        return mean

    error_mm, inside, lengths_mm = contacts.error_mm(stated_mm(answers, prior.axes)), None, None
    if names_of(prior.axes[0], "mm")[1] in answers:
        low, high = (stated_mm(answers, prior.axes, end) for end in (1, 2))
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
        _accepted_mm(error_mm, weight, built.metadata.seed + SEED_SHIFT),
        () if extent.axes == 1 else _regions(prior, model),
    )


def _edges_of(prior: Prior, most: int) -> list[Floats]:
    """Return the edges of parts of equal length, `most` along the longest axis and as long along the others."""
    size = prior.extent.size_mm
    counts = np.maximum(1, np.round(most * size / size.max())).astype(int)
    return [np.linspace(*ends, count + 1) for ends, count in zip(prior.extent.ranges_mm, counts, strict=True)]


def _regions(prior: Prior, model: ModelFile) -> tuple[Region, ...]:
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


MAX_CHARTED = 8
"""Number of components that are drawn: a chart has as many colours."""


def page(facts: Facts) -> str:
    """Return the page as text; the template escapes all text but the style sheet and the drawings."""
    here = files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"digits": digits, "code": _marked, "place": _place}
    environment.globals |= {"with_error": with_error, "rounded": rounded}
    template = environment.from_string(here.joinpath("page.html").read_text(encoding="utf-8"))
    surface, placement = facts.built.layout.surface, facts.built.layout.placement
    ringing = surface.ringing
    metadata, profile = facts.model.metadata, facts.profile
    small, in_small = fine_unit(metadata.unit)
    drawing, caption = _drawing(facts)
    components = principal_components(surface.influence.matrix(placement.place_mm))
    middle_force_n = sum(facts.scene.contact.force_range_n) / 2
    charts: dict[str, str] = {}
    if metadata.width_mm is None:
        for name, chart, remark in _charts(facts, components.transformed * middle_force_n):
            charts |= {name: draw(chart), f"{name}_caption": f"{chart.says}{remark}."}
    else:
        for name, picture, caption_of in _maps(facts):
            charts |= {name: picture, f"{name}_caption": f"{caption_of}."}
    return template.render(
        facts=facts,
        aim=facts.built.layout.aim,
        placement=placement,
        effects=surface.effects,
        verdicts=VERDICTS,
        places=places_of(facts.scene, metadata),
        parts=parts_of(surface, metadata),
        can=can(metadata, profile.force_n),
        cannot=cannot(metadata),
        questions=questions(
            surface,
            metadata,
            (profile.first.error_mm.value, profile.last.error_mm.value),
            profile.middle.error_mm.value,
            profile.accepted_mm,
        ),
        sought=SOUGHT,
        smallest_n=extremes(metadata.smallest_force.force_n),
        components=components,
        middle_force_n=middle_force_n,
        where=_where(facts.scene),
        noun=noun_of(metadata),
        axes=list(zip(metadata.axes, metadata.extent.ranges_mm, strict=True)),
        by_axis=_by_axis,
        whole="length" if metadata.width_mm is None else "diagonal",
        of_axis=[""] if len(metadata.axes) == 1 else [f" in {axis}" for axis in metadata.axes],
        place_head=PLACE_HEADS[len(metadata.axes) - 1],
        place_of={channel.name: in_words(list(metadata.place_of(channel).values())) for channel in metadata.layout},
        fine_unit=small.replace("um", "µm"),
        in_fine=in_small,
        of_unit=lambda value: f"{digits(value, 3)} {metadata.unit}",
        css=here.joinpath("style.css").read_text(encoding="utf-8") + STYLE,
        drawing=drawing,
        drawn=caption,
        charts=charts,
        negligible=NEGLIGIBLE,
        rings=[] if ringing is None else describe_ringing(ringing, noun_of(metadata)),
        missed=unseen(metadata),
        weak=weak_spot(metadata, facts.scene),
        touch=per_day(metadata.thresholds.false_contacts_per_day),
    )


def _by_axis(part: Part) -> list[str]:
    """Return length in mm and share in percent of the intervals of each axis."""
    pairs = zip(part.interval_mm, (share.scaled(100) for share in part.held), strict=True)
    return [with_error(each.value, each.standard_error, "±") for pair in pairs for each in pair]


def _place(stated: float | list[float]) -> str:
    """Return a place of a layout in words, with four digits."""
    numbers = [digits(number, 4) for number in np.atleast_1d(stated)]
    return numbers[0] if len(numbers) == 1 else f"({', '.join(numbers)})"


def _drawing(facts: Facts) -> tuple[str, str]:
    """Return the picture of the structure and the sentences of its caption."""
    scene, metadata = facts.scene, facts.model.metadata
    if scene.plate is None:
        drawing, caption = beam_drawing(scene, metadata)
        return drawing, (
            "The beam at rest, to scale along its length, in mm from its left end; supports are symbols, and sensors "
            f"as wide as their housings. {caption}"
        )
    drawing, caption = plate_drawing(scene, scene.plate, metadata)
    return drawing, (
        f"The plate from above, to scale, with sensors as wide as their housings; {caption}. Supports: "
        f"{supports_in_words(scene.plate)}"
    )


def _marked(text: str) -> Markup:
    """Return text for a terminal as HTML, with what stands in backticks as code."""
    typeset = re.sub(r"(?<=\d )um\b", "µm", text).replace("+-", "±")
    return Markup(re.sub(r"`([^`]*)`", r"<code>\1</code>", str(escape(typeset))))  # noqa: S704  it is escaped


def _charts(facts: Facts, components_mm: Floats) -> list[tuple[str, Chart, str]]:
    """Return each chart with its name and a remark for its caption; the components are (loads, sensors)."""
    profile, x = facts.profile, facts.profile.position_mm.tolist()
    x_label, stretches = "position of the contact, mm", f"; {PROFILE_BINS} stretches"
    says = "Mean error of position over the position of the contact, of the model and at the accuracy limit"
    curves = [
        Series("model", x, profile.model_mm.tolist(), 1),
        Series("accuracy limit", x, profile.limit_mm.tolist(), 0, "dashed"),
    ]
    charts = [("error", Chart(says, x_label, "mean |error|, mm", curves, y_from_zero=True), stretches)]
    seen = facts.model.metadata.smallest_force
    says = "Smallest force that is seen over the position of the contact"
    strongest = facts.model.metadata.ranges.force_n[1]
    forces = [strongest if force is None else min(force, strongest) for force in seen.force_n]
    remarks = [f"even {strongest:g} N, the largest force of the scene, is not seen where the curve reaches it"]
    remarks += [nothing_seen(facts.model.metadata)]
    remark = "".join(f"; {text}" for text in remarks if text) if strongest in forces else ""
    curve = Series("", seen.position_mm, forces)
    chart = Chart(says, x_label, "force, N", [curve], log_y=True)
    charts.append(("seen", chart, remark))
    load_mm = positions_of(facts.built.layout.surface.influence.place_mm)
    scaled = components_mm / facts.model.metadata.noise.sample_mm
    says = "Components over the position of the contact, in units of the noise of a sample"
    curves = [
        Series(f"component {k + 1}", load_mm.tolist(), column.tolist(), k)
        for k, column in enumerate(scaled.T[:MAX_CHARTED])
    ]
    charts.append(("components", Chart(says, x_label, "over the noise", curves), ""))
    return charts


def _maps(facts: Facts) -> list[tuple[str, str, str]]:
    """Return each picture of a plate with its name and its caption."""
    profile, metadata, layout = facts.profile, facts.model.metadata, facts.built.layout
    size_mm, unit, strong_n = metadata.size_mm, metadata.unit, metadata.ranges.force_n[1]
    says = "Mean error of position over the plate, of the model and at the accuracy limit"
    both = [
        Map(f"{name}, mm", profile.edges_mm, values)
        for name, values in (("model", profile.model_mm), ("accuracy limit", profile.limit_mm))
    ]
    pictures = [("error", draw_maps(both, size_mm, says, across=2), f"{says}, in mm; the darker, the larger")]
    seen = metadata.smallest_force
    ticks = [np.unique(values) for values in (seen.position_mm, seen.across_mm or [])]
    around = tuple(
        np.concatenate([[low], (along[1:] + along[:-1]) / 2, [high]])
        for along, (low, high) in zip(ticks, metadata.extent.ranges_mm, strict=True)
    )
    forces = np.array([np.nan if force is None else force for force in seen.force_n])
    says = "Smallest force that is seen over the plate"
    nothing = "; a dash: nothing is seen there" if np.isnan(forces).any() else ""
    pictures.append(("seen", draw_maps([Map("N", around, forces)], size_mm, says), f"{says}, in N{nothing}"))
    edges = tuple(_edges_of(layout.prior, FINE_BINS))
    middles = grid_of([(ends[1:] + ends[:-1]) / 2 for ends in edges])
    shown = strong_n * layout.prior.influence_table(middles)
    each = [
        Map(
            f"{channel.name}: {digits(float(values.min()), 2)} to {digits(float(values.max()), 2)} {unit}",
            edges,
            values,
            with_numbers=False,
            marked_mm=(channel.position_mm, channel.across_mm or 0.0),
        )
        for channel, values in zip(metadata.layout, shown.T, strict=True)
    ]
    says = f"What each sensor, a ring, shows of {strong_n:g} N over the place of the contact"
    pictures.append(("influence", draw_maps(each, size_mm, says, across=2), f"{says}; the darker, the more"))
    says = "Regions that hold the place by 95 %, of contacts at nine places"
    picture, times = draw_regions(profile.regions, size_mm, says)
    larger = "to scale" if times == 1 else f"drawn {times:g} times larger"
    weak_n, strong_n = metadata.ranges.force_n
    of = f"{strong_n:g} N" if weak_n == strong_n else f"{strong_n:g} N, and dashed of {weak_n:g} N"
    widest = max(profile.regions, key=lambda region: region.semi_axes_mm[0]).semi_axes_mm
    told = f"the widest is {digits(2 * widest[0], 2)} by {digits(2 * widest[1], 2)} mm"
    return [*pictures, ("regions", picture, f"{says}: of {of}, {larger}; {told}")]


def _where(scene: Scene) -> str:
    """Return the caption of the table of the sensors' places."""
    if scene.measured is None:
        return "Where to drill, in mm. Places are those of the middle of a housing."
    if scene.measured.sensors_mm:
        return "Where the sensors stand, in mm. Places are those of the middle of a housing."
    return "Where the sensors are drawn, in mm: not where they stand, which is not stated, but where each shows most."
