"""The report of a build as one HTML page: no script, no request, readable on light and dark screens and on paper.

Beyond what the build measured, it shows the error along the beam, components, and other layouts.
"""

import re
from dataclasses import dataclass
from importlib.resources import files
from itertools import combinations

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape

from beamtouch_common.digits import digits
from beamtouch_common.outline import BEAM_AXES
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
from beamtouch_models.design.building.report.parts import parts_of, places_of
from beamtouch_models.design.building.report.questions import TRIED, can, cannot, questions
from beamtouch_models.design.charts import STYLE, Chart, Series, draw
from beamtouch_models.design.placement.eigenvalue_product import principal_components
from beamtouch_models.design.placement.placing import DEFAULT_AIM, score_layout
from beamtouch_models.design.placement.reasons import Costs
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, VERDICTS
from beamtouch_models.design.pricing.ringing import describe_ringing
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.sweeps import Progress
from beamtouch_models.numbers import rounded, with_error
from beamtouch_models.places import on_axis, positions_of
from beamtouch_models.runtime.description import SOUGHT, extremes, nothing_seen, per_day, unseen
from beamtouch_models.runtime.loading import ModelFile, load_bytes
from beamtouch_models.runtime.session import stated_mm

PROFILE_DRAWS, LAYOUT_DRAWS, PAIR_DRAWS, LEAST_DRAWS = 8_192, 4_096, 1_024, 256
"""Usual numbers of simulated contacts, and the smallest."""
TRIALS = 20_000
"""Simulated acceptances."""
PROFILE_BINS = 24
SEED_SHIFT = 5
"""The build uses its seed and the four after it; the report uses the next ones."""


@dataclass(frozen=True)
class Part:
    """Error and interval of position in a part of the range of contacts."""

    name: str
    error_mm: Measurement
    """Mean |error| of the model."""
    held: Measurement | None
    """Share of contacts inside their interval; None if the model gives no interval."""
    interval_mm: Measurement | None
    """Mean length of the interval."""


@dataclass(frozen=True)
class Profile:
    """Error and interval of position along the beam."""

    position_mm: Floats
    """(stretches,) middles of stretches of equal length."""
    model_mm: Floats
    """(stretches,) mean |error| of the model."""
    limit_mm: Floats
    """(stretches,) mean |error| of the posterior median."""
    whole: Part
    middle: Part
    """The middle third of the range."""
    first: Part
    """The first stretch, at the left end of the range."""
    last: Part
    force_n: Measurement | None
    """Mean |error| of force; None if the model states none."""
    accepted_mm: float
    """Bound that the mean |error| of `TRIED` contacts exceeds in one of twenty trials."""


@dataclass(frozen=True)
class OtherLayout:
    """A layout with its score and accuracy limit, for comparison."""

    name: str
    positions_mm: Floats
    log_eigenvalue_product: float
    """In the unit of `Placement.log_eigenvalue_product`."""
    limit: Measurement
    """In percent of the length."""
    costs: Costs


@dataclass(frozen=True)
class TwoFailed:
    """The two sensors whose failure together costs most."""

    names: tuple[str, str]
    limit: Measurement
    """In percent of the length."""


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
    answers, positions_mm = estimates(model, prior, contacts.drawn.deflection_mm), contacts.likely_mm[..., 0]
    edges = np.linspace(*prior.extent.range_mm, PROFILE_BINS + 1)
    stretch = np.clip(np.searchsorted(edges, positions_mm, side="right") - 1, 0, PROFILE_BINS - 1)

    def means(values: Floats) -> Floats:
        total = np.bincount(stretch.ravel(), (weight * values).ravel(), PROFILE_BINS)
        return total / np.bincount(stretch.ravel(), weight.ravel(), PROFILE_BINS)

    error_mm, inside, length_mm = contacts.error_mm(stated_mm(answers, BEAM_AXES)), None, None
    if "position_low_mm" in answers:
        low, high = (stated_mm(answers, BEAM_AXES, end) for end in (1, 2))
        inside = contacts.held(low, high)[..., 0].astype(np.float64)
        length_mm = np.broadcast_to(high - low, inside.shape)

    def part(name: str, stretches: Bools | np.bool_) -> Part:
        means_of = [None if values is None else mean_of(values, weight * stretches) for values in (inside, length_mm)]
        return Part(name, mean_of(error_mm, weight * stretches), *means_of)

    third = PROFILE_BINS // 3
    return Profile(
        (edges[1:] + edges[:-1]) / 2,
        means(error_mm),
        means(contacts.least_error_mm()),
        part("whole range", np.True_),
        part("middle third", (third <= stretch) & (stretch < 2 * third)),
        part(f"left end, to {edges[1]:.0f} mm", stretch == 0),
        part(f"right end, from {edges[-2]:.0f} mm", stretch == PROFILE_BINS - 1),
        None
        if "force_n" not in answers
        else mean_of(np.abs(answers["force_n"] - contacts.drawn.force_n), contacts.drawn.weight),
        _accepted_mm(error_mm, weight, built.metadata.seed + SEED_SHIFT),
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
    layouts = [
        OtherLayout(name, positions, score_layout(surface.influence, on_axis(positions)), each.limit, costs)
        for (name, positions), each, costs in zip(
            compared.positions_mm.items(), limits, compared.costs.values(), strict=True
        )
    ]
    return tuple(layouts), compared


MAX_CHARTED = 8
"""Number of components that are drawn: a chart has as many colours."""


def page(facts: Facts) -> str:
    """Return the page as text; the template escapes all text but the style sheet and the drawings."""
    here = files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"digits": digits, "code": _marked}
    environment.globals |= {"with_error": with_error, "rounded": rounded}
    template = environment.from_string(here.joinpath("page.html").read_text(encoding="utf-8"))
    surface, placement = facts.built.layout.surface, facts.built.layout.placement
    ringing = surface.ringing
    metadata, profile = facts.model.metadata, facts.profile
    small, in_small = fine_unit(metadata.unit)
    drawing, caption = beam_drawing(facts.scene, metadata)
    components = principal_components(surface.influence.matrix(placement.place_mm))
    middle_force_n = sum(facts.scene.contact.force_range_n) / 2
    charts: dict[str, str] = {}
    for name, chart, remark in _charts(facts, components.transformed * middle_force_n):
        charts |= {name: draw(chart), f"{name}_caption": f"{chart.says}{remark}."}
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
        fine_unit=small.replace("um", "µm"),
        in_fine=in_small,
        of_unit=lambda value: f"{digits(value, 3)} {metadata.unit}",
        css=here.joinpath("style.css").read_text(encoding="utf-8") + STYLE,
        drawing=drawing,
        drawn=caption,
        charts=charts,
        negligible=NEGLIGIBLE,
        rings=[] if ringing is None else describe_ringing(ringing, "beam" if surface.scene.has_beam else "plate"),
        missed=unseen(metadata),
        weak=weak_spot(metadata, facts.scene),
        touch=per_day(metadata.thresholds.false_contacts_per_day),
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


def _where(scene: Scene) -> str:
    """Return the caption of the table of the sensors' places."""
    if scene.measured is None:
        return "Where to drill, in mm. Places are those of the middle of a housing."
    if scene.measured.sensors_mm:
        return "Where the sensors stand, in mm. Places are those of the middle of a housing."
    return "Where the sensors are drawn, in mm: not where they stand, which is not stated, but where each shows most."
