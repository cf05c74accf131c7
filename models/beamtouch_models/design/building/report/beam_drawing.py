"""The beam with its supports and sensors, drawn to scale as SVG.

Lengths, thickness and gaps share one scale, but a thin beam is drawn thicker, and bent further, by a factor that the
caption states. Sensors are as wide as their housings. Supports, and the height of sensors, are symbols. The caption
has words for them.
"""

from collections.abc import Iterable
from html import escape

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.design.charts import fill, opening, round_ticks, stroke
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam, Support
from beamtouch_models.runtime.metadata import Metadata

WIDTH, HEIGHT, MARGIN = 900, 236, 48
"""Size of the drawing, and space beside the beam."""
BEAM_Y = 92
"""Underside of the beam."""
THINNEST_PX, THICKEST_PX = 3.0, 40.0
"""A thin beam is drawn thicker until its thinnest section has the first or its thickest the second."""
SENSOR_HEIGHT = 24.0
KEEP_OUT_LABEL_WIDTH = 52.0
"""A narrower stretch has no label."""
SCALE_Y = 200
BENT_PX = 24.0
"""Largest deflection of the bent beam as drawn, unless it is larger to scale."""

_LEAD = stroke("faint", "lead")
_THIN = stroke("muted", "thin")
_TOUCH, _TIP = stroke("s1", "touch", width=1.6), fill("s1", "tip")
WALL = 28
"""Height of a wall above the underside of the beam, in px."""
BENT = stroke("s1", "bent", width=1.4) + ' stroke-dasharray="5 3"'
SPRING = stroke("ink", "support", width=1.4)


def beam_drawing(scene: Scene, metadata: Metadata) -> tuple[str, str]:
    """Draw a scene with the layout of its model.

    Returns
    -------
    The drawing as an `<svg>` element, without a background, and its caption.
    """
    places = ", ".join(f"{channel.name} at {channel.position_mm:g} mm" for channel in metadata.layout)
    if not scene.has_beam:
        return _measured_drawing(scene, metadata, places)
    px = Scale(scene.beam.length_mm, _thicknesses_mm(scene.beam))
    says = f"The beam, {scene.beam.length_mm:g} mm long, to scale. {_supports_in_words(scene.beam)}. Sensors: {places}."
    bent, bent_in_words = _bend(scene, metadata, px)
    parts = [
        opening("drawing", WIDTH, HEIGHT, says),
        *_keep_outs(scene, px),
        *bent,
        *_sensors(scene, metadata, px),
        *_foundation(scene.beam, px),
        *_beam(scene.beam, px),
        *_supports(scene.beam, px),
        *_contact(scene, px),
        *_scale(px),
        "</svg>",
    ]
    foundation = [] if scene.beam.foundation_n_mm2 is None else ["it lies on an elastic foundation"]
    ruled = ["shaded: no sensors there"] if scene.sensors.keep_out_mm else []
    told = [_thickness_in_words(px), *foundation, *ruled, *bent_in_words, _supports_in_words(scene.beam)]
    return "\n".join(parts), ". ".join(f"{sentence[0].upper()}{sentence[1:]}" for sentence in told)


def _measured_drawing(scene: Scene, metadata: Metadata, places: str) -> tuple[str, str]:
    """Draw a measured structure as a line; how it is held and what it looks like is not known."""
    px = Scale(scene.length_mm, [None])
    says = f"The structure, {scene.length_mm:g} mm long, as a line. Sensors: {places}."
    line = rect(fill("muted", "beam"), px.x(0.0), BEAM_Y - THINNEST_PX, scene.length_mm * px.factor, THINNEST_PX)
    drawn = [*_sensors(scene, metadata, px), line, *_contact(scene, px), *_scale(px)]
    caption = "The structure as a line: its shape and supports are not known, as its influence was measured"
    return "\n".join([opening("drawing", WIDTH, HEIGHT, says), *drawn, "</svg>"]), caption


class Scale:
    """From mm to px, the same along and across the beam; a thin beam is drawn thicker."""

    def __init__(self, length_mm: float, thickness_mm: list[float | None]) -> None:
        self.length_mm = length_mm
        self.factor = (WIDTH - 2 * MARGIN) / length_mm
        self.thickness_mm = thickness_mm
        known = [mm for mm in self.thickness_mm if mm]
        self.thicker = 1.0
        """Factor by which the beam is drawn thicker."""
        if known:
            most = max(1.0, THICKEST_PX / (max(known) * self.factor))
            self.thicker = min(max(1.0, THINNEST_PX / (min(known) * self.factor)), most)

    def x(self, at_mm: float) -> float:
        """Return where a position on the beam is."""
        return MARGIN + at_mm * self.factor

    def height(self, thickness_mm: float | None) -> float:
        """Return the height of a section."""
        return max(1.0, thickness_mm * self.factor * self.thicker) if thickness_mm else THINNEST_PX

    def top(self, at_mm: float, beam: Beam) -> float:
        """Return the upper edge of the beam at a position."""
        ends = [section.to_mm for section in beam.sections]
        return BEAM_Y - self.height(self.thickness_mm[np.searchsorted(ends, at_mm)])


def _thicknesses_mm(beam: Beam) -> list[float | None]:
    """Return the thickness of each section; None if the scene does not state it."""
    return [segment.thickness_mm or beam.thickness_mm for segment in beam.segments] or [beam.thickness_mm]


def rect(paint: str, x: float, y: float, width: float, height: float) -> str:
    """Return a rectangle."""
    return f'<rect {paint} x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"/>'


def text_at(x: float, y: float, text: str) -> str:
    """Return a text centred at x."""
    return f'<text x="{x:.1f}" y="{y:g}" text-anchor="middle">{escape(text)}</text>'


def _beam(beam: Beam, px: Scale) -> Iterable[str]:
    start = 0.0
    for section, thickness in zip(beam.sections, px.thickness_mm, strict=True):
        height = px.height(thickness)
        yield rect(fill("muted", "beam"), px.x(start), BEAM_Y - height, (section.to_mm - start) * px.factor, height)
        start = section.to_mm


def _supports(beam: Beam, px: Scale) -> Iterable[str]:
    for support in beam.support_list:
        top, at_start = px.top(support.at_mm, beam), support.at_mm == 0
        yield _support(support, px.x(support.at_mm), top, at_start=at_start)


def _bend(scene: Scene, metadata: Metadata, px: Scale) -> tuple[list[str], list[str]]:
    """Return the beam as the largest force bends it where it yields most, drawn and in words."""
    drawn, force_n = metadata.drawn, scene.contact.force_range_n[1]
    deflection_mm = np.array(drawn.deflection_mm_per_n) * force_n
    load = int(np.abs(deflection_mm).max(axis=1).argmax())
    largest_px = float(np.abs(deflection_mm[load]).max()) * px.factor
    if not largest_px:
        return [], []
    times = max(1.0, _round_down(BENT_PX / largest_px))
    pairs = zip(drawn.at_mm, deflection_mm[load], strict=True)
    points = " ".join(f"{px.x(position_mm):.1f},{BEAM_Y + times * mm * px.factor:.1f}" for position_mm, mm in pairs)
    larger = "to scale" if times == 1 else f"drawn {times:g} times larger and behind the sensors"
    words = f"dashed: bent by {force_n:g} N at {digits(drawn.load_mm[load], 4)} mm, {larger}"
    return [f'<polyline {BENT} points="{points}"/>'], [words]


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
    for index, channel in enumerate(metadata.layout):
        x, top = px.x(channel.position_mm), BEAM_Y + gap
        held = channel.position_mm in fixed
        label_y = BEAM_Y + 56 + 30 * (index % 2)  # labels of close neighbours would overlap
        yield f'<line {_LEAD} x1="{x:.1f}" x2="{x:.1f}" y1="{top + SENSOR_HEIGHT:.1f}" y2="{label_y - 11}"/>'
        paint = fill("s3", "sensor", "fixed") if held else fill("s0", "sensor")
        yield rect(paint, x - width / 2, top, width, SENSOR_HEIGHT)
        yield text_at(x, label_y, f"{channel.name}{' (fixed)' if held else ''}")
        yield text_at(x, label_y + 14, f"{channel.position_mm:g}")


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


def _thickness_in_words(px: Scale) -> str:
    known = [mm for mm in px.thickness_mm if mm]
    if not known:
        return "its thickness is not stated"
    if len(set(known)) < 4:
        thickness = f"{' and '.join(f'{mm:g}' for mm in sorted(set(known)))} mm thick"
    else:
        thickness = f"{min(known):g} to {max(known):g} mm thick, in steps"
    return thickness + (f", drawn {digits(px.thicker, 2)} times thicker" if px.thicker != 1 else "")


def _supports_in_words(beam: Beam) -> str:
    """Return where and how a beam is held, in the words of an engineer."""
    return "Supports: " + (
        "; ".join(f"at {support.at_mm:g} mm a {_in_words(support)}" for support in beam.support_list) or "none"
    )


def _in_words(support: Support) -> str:
    if support.kind == "fixed":
        return "clamp" if support.holds_lengthwise else "clamp that can slide"
    turns = "can turn against a spring" if support.fixity else "can turn"
    return f"pin that {turns}, not slide" if support.holds_lengthwise else f"roller that {turns} and slide"


def _support(support: Support, x: float, top: float, *, at_start: bool) -> str:
    """Draw a support of a beam, whose upper edge is `top`, as a single path."""
    underside = float(BEAM_Y)
    if support.kind == "fixed" and support.holds_lengthwise:
        # A wall at the left end stands left of the beam, any other wall right of its position.
        side = -1 if at_start else 1
        hatches = "".join(f" M{x:.1f} {underside - WALL + 8 * i:.1f} l{8 * side} 7" for i in range(6))
        parts = f"M{x:.1f} {underside - WALL:.1f} v48{hatches}"
    elif support.kind == "fixed":
        # Rollers on both sides of the beam let it slide and keep it from turning.
        middle = x + 9 if at_start else x - 9
        rollers = [_circle(middle + dx, y, 4) for dx in (-6, 6) for y in (underside + 4, top - 4)]
        parts = " ".join([*rollers, _ground(middle, underside + 8, 5), _ground(middle, top - 8, -5)])
    elif support.holds_lengthwise:
        parts = f"M{x:.1f} {underside:.1f} l-9 16 h18 z {_ground(x, underside + 16, 5)}"
    else:
        parts = f"{_circle(x, underside + 8, 8)} {_ground(x, underside + 16, 5)}"
    if support.fixity:
        parts += f" M{x - 14:.1f} {underside + 2:.1f} a14 14 0 0 0 28 0 l4 4 m-4 -4 l-5 3"
    return f'<path {stroke("ink", "support", width=1.4)} d="{parts}"/>'


def _ground(x: float, y: float, depth: float) -> str:
    hatches = "".join(f" M{x - 8 + 7 * i:.1f} {y:.1f} l-5 {depth:g}" for i in range(4))
    return f"M{x - 13:.1f} {y:.1f} h26{hatches}"


def _circle(x: float, y: float, r: float) -> str:
    return f"M{x - r:.1f} {y:.1f} a{r:g} {r:g} 0 1 0 {2 * r:g} 0 a{r:g} {r:g} 0 1 0 {-2 * r:g} 0"
