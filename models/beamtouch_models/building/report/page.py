"""The report of a build as one HTML page: no script, no request, readable on light and dark screens and on paper."""

from importlib.resources import files

from jinja2 import Environment, StrictUndefined

from beamtouch_common.digits import digits
from beamtouch_models.building.remarks import weak_spot
from beamtouch_models.building.report.beam_drawing import beam_drawing
from beamtouch_models.building.report.facts import PROFILE_BINS, Facts, failed_rows, price_rows
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

Rows = list[tuple[str, ...]]


def page(facts: Facts) -> str:
    """Return the page as text; the template escapes all text but the style sheet and the drawings."""
    here = files(__package__)
    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(
        here.joinpath("page.html").read_text(encoding="utf-8")
    )
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
        rows={
            "layout": _layout(facts),
            "accuracy": _accuracy(facts),
            "layouts": _layouts(facts),
            "components": _components(facts),
            "effects": _effects(facts),
            "noise": _noise(facts),
            "floor": _floor(facts),
            "prices": price_rows(facts.prices),
            "failed": failed_rows(facts.model.metadata),
        },
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


def _layout(facts: Facts) -> Rows:
    length, fixed = facts.model.metadata.length_mm, set(facts.scene.sensors.fixed_mm)
    return [
        (
            channel.name,
            f"{channel.position_mm:g}",
            f"{channel.position_mm / length:.4f}",
            "the scene" if channel.position_mm in fixed else "the search",
        )
        for channel in facts.model.metadata.layout
    ]


def _accuracy(facts: Facts) -> Rows:
    accuracy, mm = facts.model.metadata.accuracy, facts.model.metadata.length_mm / 100
    return [
        (name, f"{three_digits(mean)} ± {digits(error, 1)}", f"{digits(mean * mm, 3)} ± {digits(error * mm, 1)}")
        for name, mean, error in (
            ("model", accuracy.error_percent, accuracy.error_standard_error),
            ("accuracy limit", accuracy.limit_percent, accuracy.limit_standard_error),
        )
    ]


def _layouts(facts: Facts) -> Rows:
    least = min(layout.limit.percent for layout in facts.layouts)
    return [
        (
            layout.name,
            ", ".join(digits(x, 4) for x in layout.positions_mm),
            f"{layout.log_eigenvalue_product:.4f}".replace("-inf", "-∞"),
            f"{three_digits(layout.limit.percent)} ± {digits(layout.limit.standard_error, 1)}",
            f"{layout.limit.percent / least:.2f}",
        )
        for layout in facts.layouts
    ]


def _components(facts: Facts) -> Rows:
    eigenvalues, noise_mm = facts.components.eigenvalues, facts.model.metadata.noise.sample_mm
    sizes_mm = eigenvalues**0.5 * facts.middle_force_n
    return [
        (str(k), digits(size, 3), digits(size / noise_mm, 3), digits(eigenvalue / eigenvalues[0], 3))
        for k, (size, eigenvalue) in enumerate(zip(sizes_mm, eigenvalues, strict=True), start=1)
    ]


def _effects(facts: Facts) -> Rows:
    return [
        (effect.name, "-" if effect.price is None else digits(effect.price, 3), effect.verdict, effect.reason)
        for effect in facts.effects
    ]


def _floor(facts: Facts) -> Rows:
    floor, layout = facts.model.metadata.floor, facts.model.metadata.layout
    each = zip(layout, floor.gain, floor.zero_mm, strict=True)
    return [(channel.name, digits(100 * gain, 3), digits(1000 * zero, 3)) for channel, gain, zero in each]


def _noise(facts: Facts) -> Rows:
    metadata = facts.model.metadata
    noise, chosen, sensor = metadata.noise, metadata.filter, metadata.sensor
    percent = 100 / metadata.max_deflection_mm
    spike = "none" if chosen.spike_mm is None else f"beyond {digits(chosen.spike_mm, 3)} mm from the median of three"
    return [
        (
            "noise of a reading",
            f"{digits(noise.reading_mm, 3)} mm",
            f"{noise.reading_mm * percent:.2f} % of the largest deflection",
        ),
        (
            "noise of a sample",
            f"{digits(noise.sample_mm, 3)} mm",
            f"{noise.sample_mm * percent:.2f} % of the largest deflection",
        ),
        ("filter", chosen.kind, f"{chosen.window} to {chosen.max_readings} readings"),
        ("spike filter", spike, ""),
        ("rate", f"{sensor.rate_hz:g} Hz", "readings of every channel"),
        ("ADC", f"{sensor.adc_bits} bits", f"{digits(sensor.gain_mm_per_count * 1e3, 3)} µm per count"),
        ("gap", f"{sensor.range_mm[0]:g} to {sensor.range_mm[1]:g} mm", f"{digits(sensor.standoff_mm, 4)} mm at rest"),
    ]
