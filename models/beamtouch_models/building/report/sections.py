"""The sections of the report, each from the facts to its elements."""

from collections.abc import Iterable

import numpy as np

from beamtouch_models.building.report.beam_drawing import beam_drawing
from beamtouch_models.building.report.facts import PROFILE_BINS, Facts
from beamtouch_models.building.report.markup import chart_figure, details, figure, heading, paragraph, table, tiles
from beamtouch_models.charts import Chart, Series
from beamtouch_models.metadata import Accuracy
from beamtouch_models.pricing.prices import NEGLIGIBLE

CHARTED = 8
"""Components drawn at most: a chart has as many colours."""


def everything(facts: Facts) -> Iterable[str]:
    """Yield all sections, from the answer to its grounds."""
    yield from _summary(facts)
    yield from _layout(facts)
    yield from _accuracy(facts)
    yield from _interval(facts)
    yield from _layouts(facts)
    yield from _components(facts)
    yield from _search(facts)
    yield from _physics(facts)
    yield from _noise(facts)
    yield from _origin(facts)


def _summary(facts: Facts) -> Iterable[str]:
    metadata = facts.model.metadata
    accuracy = metadata.accuracy
    error_mm, limit_mm = (x / 100 * metadata.length_mm for x in (accuracy.error_percent, accuracy.limit_percent))
    wanted = facts.scene.requirements.position_error_mm
    verdict = "" if wanted is None else f"; {wanted:g} mm wanted, {'kept' if error_mm <= wanted else 'not kept'}"
    latency = metadata.filter.settling_ms
    yield f"<header><h1>{metadata.name}</h1>"
    yield paragraph(f"Report of the build of model {facts.model.identity}.", quiet=True)
    yield "</header>"
    yield tiles(
        [
            ("sensors", str(len(metadata.layout)), f"works with {metadata.min_channels} or more"),
            ("mean error", f"{error_mm:.3g} mm", f"{accuracy.error_percent:.2f} % of the length{verdict}"),
            ("accuracy limit", f"{limit_mm:.3g} mm", f"{accuracy.limit_percent:.2f} %; no estimator does better"),
            ("error over limit", f"{accuracy.ratio:.2f}", f"{_spread(accuracy)}1 is the best there is"),
            ("settled after", f"{latency:g} ms", "a sample is a reading" if latency == 0 else "of filtering"),
        ]
    )


def _spread(accuracy: Accuracy) -> str:
    spread = accuracy.ratio_standard_error
    return "" if spread is None else f"± {spread:.1g}; "


def _layout(facts: Facts) -> Iterable[str]:
    metadata = facts.model.metadata
    fixed = set(facts.scene.sensors.fixed_mm)
    travel, standoff = metadata.max_deflection_mm, metadata.sensor.standoff_mm
    yield heading("Beam and layout")
    caption = (
        f"To scale along and across the beam, positions in mm from its left end; the bodies of supports and sensors "
        f"are signs. At rest the gap is {standoff:.3g} mm, and the beam travels up to {travel:.3g} mm."
        f"{' Sensors keep out of the shaded stretches.' if facts.scene.sensors.keep_out_mm else ''}"
    )
    yield figure(beam_drawing(facts.scene, metadata), caption, chart=False)
    rows = [
        (
            channel.name,
            f"{channel.position_mm:g}",
            f"{channel.position_mm / metadata.length_mm:.4f}",
            "the scene" if channel.position_mm in fixed else "the search",
        )
        for channel in metadata.layout
    ]
    yield table("The layout.", ("channel", "position, mm", "over the length", "chosen by"), rows, words=(3,))


def _accuracy(facts: Facts) -> Iterable[str]:
    profile, accuracy = facts.profile, facts.model.metadata.accuracy
    yield heading("Error along the beam")
    yield paragraph(
        "The accuracy limit is the mean error of the posterior median of position, on which no estimator improves. "
        "Contacts are drawn uniformly from the scene's ranges, with the noise of a sample."
    )
    x = profile.position_mm.tolist()
    says = "Mean error of position over the position of the contact, of the model and at the accuracy limit"
    curves = [
        Series("model", x, profile.model_mm.tolist(), 1),
        Series("accuracy limit", x, profile.limit_mm.tolist(), 0, "dashed"),
    ]
    chart = Chart(says, "position of the contact, mm", "mean |error|, mm", curves, y_from_zero=True)
    yield chart_figure(chart, f"{says}; {PROFILE_BINS} stretches.")
    length = facts.model.metadata.length_mm
    measured = (
        ("model", accuracy.error_percent, accuracy.error_standard_error),
        ("accuracy limit", accuracy.limit_percent, accuracy.limit_standard_error),
    )
    yield table(
        "Mean over the whole contact range, on the same contacts, with standard errors.",
        ("estimator", "% of the length", "mm"),
        [
            (name, f"{mean:.3f} ± {error:.3f}", f"{mean * length / 100:.3g} ± {error * length / 100:.1g}")
            for name, mean, error in measured
        ],
    )


def _interval(facts: Facts) -> Iterable[str]:
    """Where the stated interval holds the truth; nothing for a model that states none."""
    profile = facts.profile
    if profile.held is None or profile.held_in is None or profile.width_mm is None:
        return
    yield heading("Interval along the beam")
    third = slice(PROFILE_BINS // 3, 2 * PROFILE_BINS // 3)
    ends_mm, middle_mm = profile.width_mm[[0, -1]].mean(), profile.width_mm[third].mean()
    whole, first, last = (f"{part.value * 100:.1f} ± {part.standard_error * 100:.1f} %" for part in profile.held_in)
    yield paragraph(
        f"The interval of 95 % held {whole} of the contacts; in the outer stretches {first} and {last}. "
        "It is a promise over all contacts and not at each position: where sensors tell little, the interval leans to "
        f"where contacts are likelier, and is held by the ends of the contact range. It is {ends_mm:.3g} mm wide in "
        f"the outer stretches and {middle_mm:.3g} mm in the middle third."
    )
    x = profile.position_mm.tolist()
    says = "Contacts that the stated interval holds, over the position of the contact"
    curves = [
        Series("held", x, (profile.held * 100).tolist(), 1),
        Series("stated", x, [95.0] * len(x), 0, "dashed"),
    ]
    yield chart_figure(
        Chart(says, "position of the contact, mm", "held, %", curves), f"{says}; {PROFILE_BINS} stretches."
    )


def _layouts(facts: Facts) -> Iterable[str]:
    yield heading("Layouts compared")
    least = min(layout.limit.percent for layout in facts.layouts)
    rows = [
        (
            layout.name,
            ", ".join(f"{x:.4g}" for x in layout.positions_mm),
            f"{layout.log_eigenvalue_product:.4f}" if np.isfinite(layout.log_eigenvalue_product) else "-∞",
            f"{layout.limit.percent:.3f} ± {layout.limit.standard_error:.3f}",
            f"{layout.limit.percent / least:.2f}",
        )
        for layout in facts.layouts
    ]
    marked = next(index for index, layout in enumerate(facts.layouts) if layout.taken)
    yield table(
        "The marked layout is the model's. Equal pitch asks for no keep-outs, distances or fixed sensors.",
        ("layout", "positions, mm", "ln of eigenvalue product", "accuracy limit, %", "over the least"),
        rows,
        marked=marked,
        words=(1,),
    )


def _components(facts: Facts) -> Iterable[str]:
    noise, force = facts.model.metadata.noise.sample_mm, facts.middle_force_n
    size = np.sqrt(facts.components.eigenvalues) * force
    yield heading("Components")
    yield paragraph(
        f"Principal components of the deflections at {force:g} N. What lies under the noise of a sample tells nothing "
        "of the contact."
    )
    x = facts.load_mm.tolist()
    shown = min(CHARTED, facts.components.transformed.shape[1])
    curves = [
        Series(f"component {k + 1}", x, (facts.components.transformed[:, k] * force / noise).tolist(), k)
        for k in range(shown)
    ]
    says = "Components over the position of the contact, in units of the noise of a sample"
    yield chart_figure(Chart(says, "position of the contact, mm", "over the noise", curves), f"{says}.")
    rows = [
        (str(k + 1), f"{value:.3g}", f"{value / noise:.3g}", f"{eigenvalue / facts.components.eigenvalues[0]:.3g}")
        for k, (value, eigenvalue) in enumerate(zip(size, facts.components.eigenvalues, strict=True))
    ]
    head = ("component", "root mean square, mm", "over the noise", "eigenvalue over the first")
    yield table("Sizes of the components.", head, rows)


def _search(facts: Facts) -> Iterable[str]:
    placement = facts.placement
    yield heading("Search")
    yield paragraph(
        f"{placement.evaluations:,} layouts scored; ln of the eigenvalue product "
        f"{placement.log_eigenvalue_product:.4f}, with lengths in units of the beam's and W/(EI) = 1."
    )
    course = [value for value in placement.convergence if np.isfinite(value)]
    if len(course) > 1:
        says = "The best score over the generations of the search"
        curve = [Series("", list(range(len(course))), course)]
        chart = Chart(says, "generation", "ln of eigenvalue product", curve, whole_x=True)
        yield chart_figure(chart, f"{says}.")


def _physics(facts: Facts) -> Iterable[str]:
    yield heading("Physics in and out")
    yield paragraph(
        "The price of an effect is the largest change in deflection that it causes at a sensor, over the noise of a "
        f"sample. Under {NEGLIGIBLE:g} it is left out."
    )
    rows = [
        (effect.name, "-" if effect.price is None else f"{effect.price:.3g}", effect.verdict, effect.reason)
        for effect in facts.effects
    ]
    yield table("Effects of this scene.", ("effect", "price", "verdict", "why"), rows, words=(2, 3))


def _noise(facts: Facts) -> Iterable[str]:
    metadata = facts.model.metadata
    noise, chosen, sensor = metadata.noise, metadata.filter, metadata.sensor
    largest = metadata.max_deflection_mm
    spike = "none" if chosen.spike_mm is None else f"beyond {chosen.spike_mm:.3g} mm of the median of three"
    yield heading("Noise and filter")
    rows = [
        (
            "noise of a reading",
            f"{noise.reading_mm:.3g} mm",
            f"{noise.reading_mm / largest * 100:.2f} % of the largest deflection",
        ),
        (
            "noise of a sample",
            f"{noise.sample_mm:.3g} mm",
            f"{noise.sample_mm / largest * 100:.2f} % of the largest deflection",
        ),
        ("filter", chosen.kind, f"{chosen.window} readings, settled after {chosen.settling_ms:g} ms"),
        ("spike filter", spike, ""),
        ("rate", f"{sensor.rate_hz:g} Hz", "readings of every channel"),
        ("ADC", f"{sensor.adc_bits} bits", f"{sensor.gain_mm_per_count * 1e3:.3g} µm a count"),
        ("gap", f"{sensor.range_mm[0]:g} to {sensor.range_mm[1]:g} mm", f"{sensor.standoff_mm:.4g} mm at rest"),
    ]
    yield table(
        "From a reading to a sample; noise is a standard deviation.",
        ("quantity", "value", "remark"),
        rows,
        words=(1, 2),
    )


def _origin(facts: Facts) -> Iterable[str]:
    metadata = facts.model.metadata
    yield heading("Origin")
    yield paragraph(
        f"Estimator {metadata.estimator}, seed {metadata.seed}, {len(metadata.golden.valid)} golden answers in the "
        "file. The same scene and seed give the same file."
    )
    yield details("The scene", metadata.scene)
