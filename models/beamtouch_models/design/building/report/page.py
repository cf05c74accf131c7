"""The report of a build as one HTML page: no script, no request, readable on light and dark screens and on paper."""

import re
from importlib.resources import files

import numpy as np
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup, escape

from beamtouch_common.digits import digits
from beamtouch_common.units import fine_unit
from beamtouch_models.arrays import Floats
from beamtouch_models.design.building.remarks import weak_spot
from beamtouch_models.design.building.report.beam_drawing import beam_drawing
from beamtouch_models.design.building.report.facts import PROFILE_BINS, Facts, Part, edges_of
from beamtouch_models.design.building.report.parts import (
    PLACE_HEADS,
    parts_of,
    places_of,
    quantity_of,
    supports_in_words,
)
from beamtouch_models.design.building.report.plate_pictures import (
    Map,
    draw_maps,
    draw_regions,
    plate_drawing,
)
from beamtouch_models.design.building.report.questions import can, cannot, noun_of, questions
from beamtouch_models.design.charts import STYLE, Chart, Series, draw
from beamtouch_models.design.placement.eigenvalue_product import principal_components
from beamtouch_models.design.pricing.effect import NEGLIGIBLE, VERDICTS
from beamtouch_models.design.pricing.ringing import describe_ringing
from beamtouch_models.design.scene import Scene
from beamtouch_models.numbers import rounded, with_error
from beamtouch_models.places import grid_of, in_words, positions_of
from beamtouch_models.runtime.description import SOUGHT, extremes, nothing_seen, per_day, unseen

FINE_BINS = 28
"""Parts along the longer side of a picture without numbers."""
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
        quantity=quantity_of(metadata.unit),
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
    if not scene.has_two_axes:
        drawing, caption = beam_drawing(scene, metadata)
        return drawing, (
            "The beam at rest, to scale along its length, in mm from its left end; supports are symbols, and sensors "
            f"as wide as their housings. {caption}"
        )
    drawing, caption = plate_drawing(scene, metadata)
    held = "Its supports are not known, as its influence was measured"
    if scene.plate is not None:
        held = f"Supports: {supports_in_words(scene.plate)}"
    return drawing, f"The plate from above, to scale, with sensors as wide as their housings; {caption}. {held}"


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
    edges = tuple(edges_of(layout.prior.extent, FINE_BINS))
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
