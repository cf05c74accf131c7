"""The beam with its supports and sensors, drawn to scale as SVG.

Lengths, thickness and gaps share one scale; supports and sensors are symbols.
"""

from collections.abc import Iterable
from html import escape

from beamtouch_models.charts import round_ticks
from beamtouch_models.metadata import Channel, Metadata
from beamtouch_models.scene import Scene
from beamtouch_models.structure import Beam
from beamtouch_models.svg import fill, opening, stroke

WIDTH, HEIGHT, MARGIN = 900, 236, 48
BEAM_Y = 92
"""Underside of the beam."""
THINNEST_PX = 3.0
SENSOR_WIDTH, SENSOR_HEIGHT = 12.0, 24.0
LABEL_WIDTH = 48.0
"""Labels closer than this stand in two rows."""
KEEP_OUT_LABEL_WIDTH = 52.0
"""A narrower stretch has no label; the caption explains its colour."""
SCALE_Y = 200


_SUPPORT = stroke("ink", "support", width=1.4)
_LEAD = stroke("faint", "lead")
_THIN = stroke("muted", "thin")
_TOUCH, _TIP = stroke("s1", "touch", width=1.6), fill("s1", "tip")


def beam_drawing(scene: Scene, metadata: Metadata) -> str:
    """Draw a scene with the layout of its model as an `<svg>` element, without a background."""
    px = _Scale(scene.beam.length_mm)
    places = ", ".join(f"{channel.name} at {channel.position_mm:g} mm" for channel in metadata.layout)
    supports = ", ".join(f"{support.kind} at {support.at_mm:g} mm" for support in scene.beam.support_list)
    says = f"The beam, {scene.beam.length_mm:g} mm long, to scale. Supports: {supports or 'none'}. Sensors: {places}."
    parts = [
        opening("drawing", WIDTH, HEIGHT, says),
        *_keep_outs(scene, px),
        *_sensors(scene, metadata, px),
        *_foundation(scene.beam, px),
        *_beam(scene.beam, px),
        *_supports(scene.beam, px),
        *_contact(scene, px),
        *_scale(px),
        "</svg>",
    ]
    return "\n".join(parts)


class _Scale:
    """From mm to px, the same along and across the beam."""

    def __init__(self, length_mm: float) -> None:
        self.length_mm = length_mm
        self.factor = (WIDTH - 2 * MARGIN) / length_mm

    def x(self, at_mm: float) -> float:
        return MARGIN + at_mm * self.factor


def _beam(beam: Beam, px: _Scale) -> Iterable[str]:
    start = 0.0
    thicknesses = [segment.thickness_mm or beam.thickness_mm for segment in beam.segments] or [beam.thickness_mm]
    for section, thickness in zip(beam.sections, thicknesses, strict=True):
        height = max(THINNEST_PX, (thickness or 0.0) * px.factor)
        yield _rect(fill("muted", "beam"), px.x(start), BEAM_Y - height, (section.to_mm - start) * px.factor, height)
        start = section.to_mm


def _supports(beam: Beam, px: _Scale) -> Iterable[str]:
    for support in beam.support_list:
        x = px.x(support.at_mm)
        if support.kind == "simple":
            yield f'<path {_SUPPORT} d="M{x:.1f} {BEAM_Y} l-9 16 h18 z M{x - 13:.1f} {BEAM_Y + 20} h26"/>'
        else:
            # A wall at the left end stands left of the beam, any other wall right of its position.
            side = -1 if support.at_mm == 0 else 1
            hatches = "".join(f" M{x:.1f} {BEAM_Y - 28 + 8 * i} l{8 * side} 7" for i in range(6))
            yield f'<path {_SUPPORT} d="M{x:.1f} {BEAM_Y - 28} v48{hatches}"/>'


def _foundation(beam: Beam, px: _Scale) -> Iterable[str]:
    if beam.foundation_n_mm2 is None:
        return
    springs = " ".join(f"M{px.x(beam.length_mm * i / 40):.1f} {BEAM_Y} l3 3 l-6 3 l6 3 l-3 3" for i in range(41))
    yield f'<path {_SUPPORT} d="{springs}" opacity=".45"/>'


def _sensors(scene: Scene, metadata: Metadata, px: _Scale) -> Iterable[str]:
    gap = max(2.0, metadata.sensor.standoff_mm * px.factor)
    fixed = set(scene.sensors.fixed_mm)
    for channel, row in _rows(metadata.layout, px):
        x, top = px.x(channel.position_mm), BEAM_Y + gap
        held = channel.position_mm in fixed
        label_y = BEAM_Y + 56 + 30 * row
        yield f'<line {_LEAD} x1="{x:.1f}" x2="{x:.1f}" y1="{top + SENSOR_HEIGHT:.1f}" y2="{label_y - 11}"/>'
        paint = fill("s3", "sensor", "fixed") if held else fill("s0", "sensor")
        yield _rect(paint, x - SENSOR_WIDTH / 2, top, SENSOR_WIDTH, SENSOR_HEIGHT)
        yield _text(x, label_y, f"{channel.name}{' (fixed)' if held else ''}")
        yield _text(x, label_y + 14, f"{channel.position_mm:g}")


def _rows(layout: list[Channel], px: _Scale) -> Iterable[tuple[Channel, int]]:
    """Yield each channel with the row of its label; close neighbours alternate between two rows."""
    before, row = -float("inf"), 0
    for channel in layout:
        x = px.x(channel.position_mm)
        row = 1 - row if x - before < LABEL_WIDTH else 0
        before = x
        yield channel, row


def _keep_outs(scene: Scene, px: _Scale) -> Iterable[str]:
    for start, end in scene.sensors.keep_out_mm:
        yield _rect(f'{fill("s1", "keepout")} opacity=".16"', px.x(start), BEAM_Y, (end - start) * px.factor, 40)
        if (end - start) * px.factor > KEEP_OUT_LABEL_WIDTH:
            yield _text(px.x((start + end) / 2), BEAM_Y + 36, "keep out")


def _contact(scene: Scene, px: _Scale) -> Iterable[str]:
    (low, high), (weak, strong) = scene.contact.position_mm, scene.contact.force_range_n
    left, right, y = px.x(low), px.x(high), 32
    force = f"{weak:g} N" if weak == strong else f"{weak:g} to {strong:g} N"
    yield _text((left + right) / 2, y - 12, f"contact anywhere from {low:g} to {high:g} mm, {force}")
    yield f'<path {_TOUCH} d="M{left:.1f} {y + 6} v-6 H{right:.1f} v6"/>'
    for i in range(5):
        x = left + (right - left) * i / 4
        yield f'<path {_TOUCH} d="M{x:.1f} {y} v22"/><path {_TIP} d="M{x - 4:.1f} {y + 20} h8 l-4 8 z"/>'


def _scale(px: _Scale) -> Iterable[str]:
    yield f'<line {_THIN} x1="{px.x(0):.1f}" x2="{px.x(px.length_mm):.1f}" y1="{SCALE_Y}" y2="{SCALE_Y}"/>'
    for tick in round_ticks(0.0, px.length_mm):
        x = px.x(tick)
        yield f'<line {_THIN} x1="{x:.1f}" x2="{x:.1f}" y1="{SCALE_Y}" y2="{SCALE_Y + 5}"/>'
        yield _text(x, SCALE_Y + 19, f"{tick:g}")
    yield f'<text x="{WIDTH - 4}" y="{SCALE_Y + 19}" text-anchor="end">mm</text>'


def _rect(paint: str, x: float, y: float, width: float, height: float) -> str:
    return f'<rect {paint} x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"/>'


def _text(x: float, y: float, text: str) -> str:
    return f'<text x="{x:.1f}" y="{y:g}" text-anchor="middle">{escape(text)}</text>'
