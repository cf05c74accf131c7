"""The report of a build as one HTML page: no script, no request, readable on light and dark screens and on paper."""

from importlib.resources import files

from jinja2 import Environment, StrictUndefined

from beamtouch_common.digits import digits
from beamtouch_models.building.remarks import weak_spot
from beamtouch_models.building.report.beam_drawing import beam_drawing
from beamtouch_models.building.report.facts import PROFILE_BINS, Facts
from beamtouch_models.charts import STYLE, Chart, Series, draw
from beamtouch_models.description import answers, nothing_seen, per_day, unseen
from beamtouch_models.detection import detection_of
from beamtouch_models.numbers import three_digits
from beamtouch_models.pricing.effect import NEGLIGIBLE
from beamtouch_models.pricing.ringing import told
from beamtouch_models.surface import Surface

MIN_MISSED = 1e-4
"""Share of contacts from which missed ones are drawn; below it, the page says that there are hardly any."""
MAX_CHARTED = 8
"""Number of components that are drawn: a chart has as many colours."""


def page(facts: Facts) -> str:
    """Return the page as text; the template escapes all text but the style sheet and the drawings."""
    here = files(__package__)
    environment = Environment(autoescape=True, undefined=StrictUndefined)
    environment.filters |= {"digits": digits, "three_digits": three_digits}
    template = environment.from_string(here.joinpath("page.html").read_text(encoding="utf-8"))
    charts: dict[str, str] = {"search": "", "missed": ""}
    for name, chart, remark in _charts(facts):
        charts |= {name: draw(chart), f"{name}_caption": f"{chart.says}{remark}."}
    ringing = Surface.of(facts.scene, facts.model.metadata.filter).ringing
    width_mm = facts.profile.width_mm
    third = slice(PROFILE_BINS // 3, 2 * PROFILE_BINS // 3)
    return template.render(
        facts=facts,
        css=here.joinpath("style.css").read_text(encoding="utf-8") + STYLE,
        drawing=beam_drawing(facts.scene, facts.model.metadata),
        charts=charts,
        marked=next(index for index, layout in enumerate(facts.layouts) if layout.taken),
        widths=None if width_mm is None else {"ends_mm": width_mm[[0, -1]].mean(), "middle_mm": width_mm[third].mean()},
        negligible=NEGLIGIBLE,
        detection=detection_of(facts.model.metadata),
        answers=answers(facts.model.metadata),
        rings=[] if ringing is None else told(ringing),
        missed=unseen(facts.model.metadata),
        weak=weak_spot(facts.model.metadata),
        touch=per_day(facts.model.metadata.thresholds.false_contacts_per_day),
    )


def _charts(facts: Facts) -> list[tuple[str, Chart, str]]:
    """Return each chart with its name and a remark for its caption."""
    profile, x = facts.profile, facts.profile.position_mm.tolist()
    at, stretches = "position of the contact, mm", f"; {PROFILE_BINS} stretches"
    says = "Mean error of position over the position of the contact, of the model and at the accuracy limit"
    curves = [
        Series("model", x, profile.model_mm.tolist(), 1),
        Series("accuracy limit", x, profile.limit_mm.tolist(), 0, "dashed"),
    ]
    charts = [("error", Chart(says, at, "mean |error|, mm", curves, y_from_zero=True), stretches)]
    if profile.held is not None:
        says = "Share of contacts inside their interval, over the position of the contact"
        curves = [
            Series("held", x, (profile.held * 100).tolist(), 1),
            Series("stated", x, [95.0] * len(x), 0, "dashed"),
        ]
        charts.append(("held", Chart(says, at, "held, %", curves), stretches))
    seen = facts.model.metadata.smallest_force
    says = "Smallest force that is seen over the position of the contact"
    strongest = facts.model.metadata.ranges.force_n[1]
    forces = [strongest if force is None else min(force, strongest) for force in seen.force_n]
    remarks = [f"even {strongest:g} N, the largest force of the scene, is not seen where the curve reaches it"]
    remarks += [nothing_seen(facts.model.metadata, list(zip(seen.position_mm, seen.force_n, strict=True)))]
    remark = "".join(f"; {one}" for one in remarks if one) if strongest in forces else ""
    curve = Series("", seen.position_mm, forces)
    chart = Chart(says, at, "force, N", [curve], y_from_zero=True)
    charts.append(("seen", chart, remark))
    along = detection_of(facts.model.metadata)
    if max(along.missed) >= MIN_MISSED:
        says = f"Contacts of {along.force_n:g} N, the smallest force of the scene, that are missed along the beam"
        curve = Series("", along.position_mm, [100 * share for share in along.missed])
        remark = f"; at most {digits(100 * max(along.missed), 3)} % of settled samples"
        charts.append(("missed", Chart(says, at, "missed, %", [curve], y_from_zero=True), remark))
    scaled = facts.components.transformed * (facts.middle_force_n / facts.model.metadata.noise.sample_mm)
    says = "Components over the position of the contact, in units of the noise of a sample"
    curves = [
        Series(f"component {k + 1}", facts.load_mm.tolist(), column.tolist(), k)
        for k, column in enumerate(scaled.T[:MAX_CHARTED])
    ]
    charts.append(("components", Chart(says, at, "over the noise", curves), ""))
    course = [value for value in facts.placement.convergence if value > float("-inf")]
    if len(course) > 1:
        by_error = facts.aim.criterion == "position-error"
        says = "The best score over the steps of the search"
        curves = [Series("", list(range(len(course))), [-value for value in course] if by_error else course)]
        name = "mean position error, mm" if by_error else "ln of eigenvalue product"
        charts.append(("search", Chart(says, "step", name, curves, whole_x=True), ""))
    return charts
