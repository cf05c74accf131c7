"""The report of a build as one HTML page: no script, no request, readable on light and dark screens and on paper."""

from importlib.resources import files

import numpy as np
from jinja2 import Environment, StrictUndefined

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.building.remarks import weak_spot
from beamtouch_models.building.report.beam_drawing import beam_drawing
from beamtouch_models.building.report.facts import PROFILE_BINS, Facts
from beamtouch_models.charts import STYLE, Chart, Series, draw
from beamtouch_models.description import answers, nothing_seen, per_day, unseen
from beamtouch_models.numbers import three_digits
from beamtouch_models.placement.components import principal_components
from beamtouch_models.pricing.effect import NEGLIGIBLE
from beamtouch_models.pricing.ringing import told
from beamtouch_models.surface import Surface

MAX_CHARTED = 8
"""Number of components that are drawn: a chart has as many colours."""


def page(facts: Facts) -> str:
    """Return the page as text; the template escapes all text but the style sheet and the drawings."""
    here = files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"digits": digits, "three_digits": three_digits}
    template = environment.from_string(here.joinpath("page.html").read_text(encoding="utf-8"))
    ringing = Surface.of(facts.scene, facts.model.metadata.filter).ringing
    width_mm = facts.profile.width_mm
    third = slice(PROFILE_BINS // 3, 2 * PROFILE_BINS // 3)
    drawing, caption = beam_drawing(facts.scene, facts.model.metadata)
    surface, placement = facts.built.surface, facts.built.placement
    components = principal_components(surface.influence.matrix(np.array(placement.positions_mm)))
    middle_force_n = sum(facts.scene.contact.force_range_n) / 2
    charts: dict[str, str] = {}
    for name, chart, remark in _charts(facts, components.transformed * middle_force_n):
        charts |= {name: draw(chart), f"{name}_caption": f"{chart.says}{remark}."}
    return template.render(
        facts=facts,
        aim=facts.built.aim,
        placement=placement,
        effects=surface.effects,
        components=components,
        middle_force_n=middle_force_n,
        css=here.joinpath("style.css").read_text(encoding="utf-8") + STYLE,
        drawing=drawing,
        drawn=caption,
        charts=charts,
        marked=next(index for index, layout in enumerate(facts.layouts) if layout.taken),
        widths=None if width_mm is None else {"ends_mm": width_mm[[0, -1]].mean(), "middle_mm": width_mm[third].mean()},
        negligible=NEGLIGIBLE,
        answers=answers(facts.model.metadata),
        rings=[] if ringing is None else told(ringing),
        missed=unseen(facts.model.metadata),
        weak=weak_spot(facts.model.metadata),
        touch=per_day(facts.model.metadata.thresholds.false_contacts_per_day),
    )


def _charts(facts: Facts, components_mm: Floats) -> list[tuple[str, Chart, str]]:
    """Return each chart with its name and a remark for its caption; the components are (loads, sensors)."""
    profile, x = facts.profile, facts.profile.position_mm.tolist()
    at, stretches = "position of the contact, mm", f"; {PROFILE_BINS} stretches"
    says = "Mean error of position over the position of the contact, of the model and at the accuracy limit"
    curves = [
        Series("model", x, profile.model_mm.tolist(), 1),
        Series("accuracy limit", x, profile.limit_mm.tolist(), 0, "dashed"),
    ]
    charts = [("error", Chart(says, at, "mean |error|, mm", curves, y_from_zero=True), stretches)]
    seen = facts.model.metadata.smallest_force
    says = "Smallest force that is seen over the position of the contact"
    strongest = facts.model.metadata.ranges.force_n[1]
    forces = [strongest if force is None else min(force, strongest) for force in seen.force_n]
    remarks = [f"even {strongest:g} N, the largest force of the scene, is not seen where the curve reaches it"]
    remarks += [nothing_seen(facts.model.metadata)]
    remark = "".join(f"; {one}" for one in remarks if one) if strongest in forces else ""
    curve = Series("", seen.position_mm, forces)
    chart = Chart(says, at, "force, N", [curve], y_from_zero=True)
    charts.append(("seen", chart, remark))
    load_mm, scaled = facts.built.surface.influence.load_mm, components_mm / facts.model.metadata.noise.sample_mm
    says = "Components over the position of the contact, in units of the noise of a sample"
    curves = [
        Series(f"component {k + 1}", load_mm.tolist(), column.tolist(), k)
        for k, column in enumerate(scaled.T[:MAX_CHARTED])
    ]
    charts.append(("components", Chart(says, at, "over the noise", curves), ""))
    return charts
