"""The beam with its supports and sensors, drawn to scale as SVG.

Lengths, thickness and gaps share one scale, but a thin beam is drawn thicker, and bent further, by a factor that the
legend states. Sensors are as wide as their housings. Supports, and the height of sensors, are symbols.
"""

from collections.abc import Iterable

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.building.report.beam_legend import BENT, ROW, SPRING, Entry, bent_key, keys, legend
from beamtouch_models.building.report.beam_scale import BEAM_Y, HEIGHT, MARGIN, THINNEST_PX, WIDTH, Scale, rect, text_at
from beamtouch_models.building.report.beam_symbols import support_in_words, support_symbol
from beamtouch_models.charts import round_ticks
from beamtouch_models.metadata import Channel, Metadata
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam import Beam
from beamtouch_models.svg import fill, opening, stroke

SENSOR_HEIGHT = 24.0
LABEL_WIDTH = 48.0
"""Labels closer than this stand in two rows."""
KEEP_OUT_LABEL_WIDTH = 52.0
"""A narrower stretch has no label; the legend explains its colour."""
SCALE_Y = 200
BENT_PX = 24.0
"""Largest deflection of the bent beam as drawn, unless it is larger to scale."""
LEGEND_Y = 252
"""Middle of the first row of the legend."""

_LEAD = stroke("faint", "lead")
_THIN = stroke("muted", "thin")
_TOUCH, _TIP = stroke("s1", "touch", width=1.6), fill("s1", "tip")


def beam_drawing(scene: Scene, metadata: Metadata) -> str:
    """Draw a scene with the layout of its model as an `<svg>` element, without a background."""
    px = Scale(scene.beam)
    places = ", ".join(f"{channel.name} at {channel.position_mm:g} mm" for channel in metadata.layout)
    supports = ", ".join(f"{support_in_words(one)} at {one.at_mm:g} mm" for one in scene.beam.support_list)
    says = f"The beam, {scene.beam.length_mm:g} mm long, to scale. Supports: {supports or 'none'}. Sensors: {places}."
    bent, told = _bent(scene, metadata, px)
    below, rows = legend([*keys(scene, metadata, px), *told], MARGIN, WIDTH - 4, LEGEND_Y)
    parts = [
        opening("drawing", WIDTH, HEIGHT + rows * ROW, says),
        *_keep_outs(scene, px),
        *_sensors(scene, metadata, px),
        *_foundation(scene.beam, px),
        *_beam(scene.beam, px),
        *_supports(scene.beam, px),
        *bent,
        *_contact(scene, px),
        *_scale(px),
        *below,
        "</svg>",
    ]
    return "\n".join(parts)


def _beam(beam: Beam, px: Scale) -> Iterable[str]:
    start = 0.0
    for section, thickness in zip(beam.sections, px.thickness_mm, strict=True):
        height = px.height(thickness)
        yield rect(fill("muted", "beam"), px.x(start), BEAM_Y - height, (section.to_mm - start) * px.factor, height)
        start = section.to_mm


def _supports(beam: Beam, px: Scale) -> Iterable[str]:
    for support in beam.support_list:
        top, at_start = px.top(support.at_mm, beam), support.at_mm == 0
        yield support_symbol(support, px.x(support.at_mm), BEAM_Y, top, at_start=at_start, name="support")


def _bent(scene: Scene, metadata: Metadata, px: Scale) -> tuple[list[str], list[Entry]]:
    """Return the beam as the largest force bends it where it yields most, and the entry of the legend."""
    drawn, force_n = metadata.drawn, scene.contact.force_range_n[1]
    deflection_mm = np.array(drawn.deflection_mm_per_n) * force_n
    load = int(np.abs(deflection_mm).max(axis=1).argmax())
    largest_px = float(np.abs(deflection_mm[load]).max()) * px.factor
    if not 0 < largest_px < np.inf:
        return [], []
    times = max(1.0, _round_down(BENT_PX / largest_px))
    pairs = zip(drawn.at_mm, deflection_mm[load], strict=True)
    points = " ".join(f"{px.x(at):.1f},{BEAM_Y + times * mm * px.factor:.1f}" for at, mm in pairs)
    larger = "to scale" if times == 1 else f"{times:g} times larger"
    words = f"bent by {force_n:g} N at {digits(drawn.load_mm[load], 4)} mm, {larger}"
    return [f'<polyline {BENT} points="{points}"/>'], [(bent_key, words)]


def _round_down(value: float) -> float:
    power = 10.0 ** np.floor(np.log10(value))
    return float(max(step for step in (1, 2, 3, 4, 5, 6, 8) if step * power <= value * (1 + 1e-9)) * power)


def _foundation(beam: Beam, px: Scale) -> Iterable[str]:
    if beam.foundation_n_mm2 is None:
        return
    springs = " ".join(f"M{px.x(beam.length_mm * i / 40):.1f} {BEAM_Y} l3 3 l-6 3 l6 3 l-3 3" for i in range(41))
    yield f'<path {SPRING} d="{springs}" opacity=".45"/>'


def _sensors(scene: Scene, metadata: Metadata, px: Scale) -> Iterable[str]:
    gap = max(2.0, metadata.sensor.standoff_mm * px.factor)
    fixed, width = set(scene.sensors.fixed_mm), max(THINNEST_PX, scene.sensors.size_mm * px.factor)
    for channel, row in _rows(metadata.layout, px):
        x, top = px.x(channel.position_mm), BEAM_Y + gap
        held = channel.position_mm in fixed
        label_y = BEAM_Y + 56 + 30 * row
        yield f'<line {_LEAD} x1="{x:.1f}" x2="{x:.1f}" y1="{top + SENSOR_HEIGHT:.1f}" y2="{label_y - 11}"/>'
        paint = fill("s3", "sensor", "fixed") if held else fill("s0", "sensor")
        yield rect(paint, x - width / 2, top, width, SENSOR_HEIGHT)
        yield text_at(x, label_y, f"{channel.name}{' (fixed)' if held else ''}")
        yield text_at(x, label_y + 14, f"{channel.position_mm:g}")


def _rows(layout: list[Channel], px: Scale) -> Iterable[tuple[Channel, int]]:
    """Yield each channel with the row of its label; close neighbours alternate between two rows."""
    before, row = -float("inf"), 0
    for channel in layout:
        x = px.x(channel.position_mm)
        row = 1 - row if x - before < LABEL_WIDTH else 0
        before = x
        yield channel, row


def _keep_outs(scene: Scene, px: Scale) -> Iterable[str]:
    for start, end in scene.sensors.keep_out_mm:
        yield rect(f'{fill("s1", "keepout")} opacity=".16"', px.x(start), BEAM_Y, (end - start) * px.factor, 40)
        if (end - start) * px.factor > KEEP_OUT_LABEL_WIDTH:
            yield text_at(px.x((start + end) / 2), BEAM_Y + 36, "keep out")


def _contact(scene: Scene, px: Scale) -> Iterable[str]:
    (low, high), (weak, strong) = scene.contact.position_mm, scene.contact.force_range_n
    left, right, y = px.x(low), px.x(high), 32
    force = f"{weak:g} N" if weak == strong else f"{weak:g} to {strong:g} N"
    yield text_at((left + right) / 2, y - 12, f"contact anywhere from {low:g} to {high:g} mm, {force}")
    yield f'<path {_TOUCH} d="M{left:.1f} {y + 6} v-6 H{right:.1f} v6"/>'
    for i in range(5):
        x = left + (right - left) * i / 4
        yield f'<path {_TOUCH} d="M{x:.1f} {y} v22"/><path {_TIP} d="M{x - 4:.1f} {y + 20} h8 l-4 8 z"/>'


def _scale(px: Scale) -> Iterable[str]:
    yield f'<line {_THIN} x1="{px.x(0):.1f}" x2="{px.x(px.length_mm):.1f}" y1="{SCALE_Y}" y2="{SCALE_Y}"/>'
    for tick in round_ticks(0.0, px.length_mm):
        x = px.x(tick)
        yield f'<line {_THIN} x1="{x:.1f}" x2="{x:.1f}" y1="{SCALE_Y}" y2="{SCALE_Y + 5}"/>'
        yield text_at(x, SCALE_Y + 19, f"{tick:g}")
    yield f'<text x="{WIDTH - 4}" y="{SCALE_Y + 19}" text-anchor="end">mm</text>'
