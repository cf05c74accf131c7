"""A plate from above, drawn to scale as SVG: its layout, maps of values over it, and regions of 95 %.

A map shades rectangles by their values, and prints each value where it has room, so that it tells the same on paper and
to who sees no colours.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.building.report.beam_drawing import rect, text_at
from beamtouch_models.design.charts import Colour, fill, opening, round_ticks, stroke
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.runtime.metadata import Metadata

WIDTH, MARGIN, LOWER = 640, 48, 52
"""Width of a picture, and space beside and below a plate with a ruler, in px."""
GAP, TITLE = 40, 22
"""Space between maps side by side, and above a map, in px."""
HIGHEST = 0.75
"""Largest height of a plate over the width of its drawing."""
SUPPORT_PX = 7
FAINTEST, DARKEST = 0.06, 0.6
"""Opacity of the smallest and of the largest value of a map."""
NUMBER_PX = 30
"""Width from which on a rectangle has room for its value."""
LARGEST = 0.16
"""Length that the largest region has, over the longer side of the plate: regions are drawn larger to see them."""
CHI_SQUARE_95 = 5.991
"""Of two directions: what the square of an ellipse of 95 % is in deviations."""


@dataclass(frozen=True)
class FromAbove:
    """From mm on a plate to px, with x to the right and y upwards."""

    size_mm: tuple[float, ...]
    left: float
    top: float
    factor: float

    @classmethod
    def within(cls, size_mm: tuple[float, ...], left: float, top: float, width: float) -> "FromAbove":
        """Return the scale of a plate at most `width` px wide and HIGHEST times that high."""
        return cls(size_mm, left, top, min(width / size_mm[0], HIGHEST * width / size_mm[1]))

    @property
    def bottom(self) -> float:
        """The lower edge of the plate."""
        return self.top + self.size_mm[1] * self.factor

    @property
    def right(self) -> float:
        """The right edge of the plate."""
        return self.left + self.size_mm[0] * self.factor

    def x(self, at_mm: float) -> float:
        """Return where an x is."""
        return self.left + at_mm * self.factor

    def y(self, at_mm: float) -> float:
        """Return where a y is."""
        return self.bottom - at_mm * self.factor

    def area(self, paint: str, x_mm: tuple[float, float], y_mm: tuple[float, float]) -> str:
        """Return a rectangle on the plate."""
        size = ((ends[1] - ends[0]) * self.factor for ends in (x_mm, y_mm))
        return rect(paint, self.x(x_mm[0]), self.y(y_mm[1]), *size)

    def whole(self, paint: str) -> str:
        """Return the plate as a rectangle."""
        return self.area(paint, (0.0, self.size_mm[0]), (0.0, self.size_mm[1]))


def plate_drawing(scene: Scene, metadata: Metadata) -> tuple[str, str]:
    """Draw the layout of a plate from above: supports, keep-outs, extent of the contacts, and sensors.

    Returns
    -------
    The drawing as an `<svg>` element, without a background, and its caption.
    """
    px = FromAbove.within(metadata.size_mm, MARGIN, MARGIN / 2, WIDTH - 2 * MARGIN)
    places = ", ".join(
        f"{channel.name} at {channel.position_mm:g}, {channel.across_mm:g} mm" for channel in metadata.layout
    )
    size = " by ".join(f"{length_mm:g}" for length_mm in metadata.size_mm)
    says = f"The plate from above, {size} mm, to scale. Sensors: {places}."
    x_mm, y_mm = metadata.extent.ranges_mm
    parts = [
        opening("drawing", WIDTH, px.bottom + LOWER, says),
        px.whole(f'{fill("muted", "plate")} opacity=".14"'),
        px.whole(stroke("ink", "rim", width=1.4)),
        *_keep_outs(scene, px),
        px.area(f'{stroke("s1", "contacts", width=1.2)} stroke-dasharray="6 4"', x_mm, y_mm),
        *([] if scene.plate is None else _supports(scene.plate, px)),
        *_sensors(scene, metadata, px),
        *_ruler(px),
        "</svg>",
    ]
    ruled = "; shaded with a word: no sensors there" if scene.sensors.keep_out else ""
    if scene.plate is None:
        return "\n".join(parts), f"dashed: contacts lie within{ruled}"
    return "\n".join(parts), f"dashed: contacts lie within; supports are {_symbols_in_words(scene.plate)}{ruled}"


def _symbols_in_words(plate: Plate) -> str:
    """Return how the supports of a plate are drawn."""
    points = [support for support in plate.support_list if not support.is_line]
    rigid = any(support.stiffness_n_per_mm is None for support in points)
    words = {
        "triangles": rigid,
        "on springs zigzags" if rigid else "zigzags": any(support.stiffness_n_per_mm is not None for support in points),
        "thick lines": len(points) < len(plate.support_list),
    }
    return ", ".join(word for word, is_drawn in words.items() if is_drawn)


def _keep_outs(scene: Scene, px: FromAbove) -> Iterator[str]:
    for part in scene.sensors.keep_out:
        yield px.area(f'{fill("s1", "keepout")} opacity=".16"', part.x_mm, part.y_mm)
        middle = (sum(part.x_mm) / 2, sum(part.y_mm) / 2)
        if (part.x_mm[1] - part.x_mm[0]) * px.factor > 52:
            yield text_at(px.x(middle[0]), px.y(middle[1]) + 4, "keep out")


def _supports(plate: Plate, px: FromAbove) -> Iterator[str]:
    paint = stroke("ink", "support", width=1.6)
    for support in plate.support_list:
        if support.x_mm is None or support.y_mm is None:
            x = (0.0, plate.length_x_mm) if support.x_mm is None else (support.x_mm, support.x_mm)
            y = (0.0, plate.length_y_mm) if support.y_mm is None else (support.y_mm, support.y_mm)
            path = f"M{px.x(x[0]):.1f} {px.y(y[0]):.1f}L{px.x(x[1]):.1f} {px.y(y[1]):.1f}"
            yield f'<path {stroke("ink", "support", width=4)} d="{path}"/>'
            continue
        x_px, y_px, half = px.x(support.x_mm), px.y(support.y_mm), SUPPORT_PX
        shape = f"l{half} {1.6 * half:.1f}h{-2 * half}z"
        if support.stiffness_n_per_mm is not None:
            shape = f"v3l{half} 2l{-2 * half} 4l{2 * half} 4l{-half} 2v3"
        yield f'<path {paint} d="M{x_px:.1f} {y_px:.1f}{shape}"/>'


def _sensors(scene: Scene, metadata: Metadata, px: FromAbove) -> Iterator[str]:
    radius = max(3.0, scene.sensors.size_mm / 2 * px.factor)
    fixed = {(place.x_mm, place.y_mm) for place in scene.sensors.fixed}
    for channel in metadata.layout:
        place = tuple(metadata.place_of(channel).values())
        x, y = px.x(place[0]), px.y(place[1])
        paint = fill("s3", "sensor", "fixed") if place in fixed else fill("s0", "sensor")
        yield f'<circle {paint} cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>'
        # A label lies on the plate, whichever corner the sensor is in.
        inwards = -1 if x > (px.left + px.right) / 2 else 1
        label_y = y - radius - 6 if y > (px.top + px.bottom) / 2 else y + radius + 16
        anchor = "start" if inwards > 0 else "end"
        text = f"{channel.name}{' (fixed)' if place in fixed else ''} {place[0]:g}, {place[1]:g}"
        label_x = x + inwards * (radius + 4)
        yield f'<text x="{label_x:.1f}" y="{label_y:.1f}" text-anchor="{anchor}">{escape(text)}</text>'


def _ruler(px: FromAbove) -> Iterator[str]:
    for tick in round_ticks(0.0, px.size_mm[0]):
        x = px.x(tick)
        yield f'<path {stroke("muted", "thin")} d="M{x:.1f} {px.bottom + 2:.1f}v5"/>'
        yield text_at(x, round(px.bottom + 31, 1), f"{tick:g}")
    for tick in round_ticks(0.0, px.size_mm[1]):
        y = px.y(tick)
        yield f'<path {stroke("muted", "thin")} d="M{px.left - 2:.1f} {y:.1f}h-5"/>'
        yield f'<text x="{px.left - 10:.1f}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>'
    yield f'<text x="{px.right:.1f}" y="{px.bottom + 46:.1f}" text-anchor="end">x and y in mm</text>'


@dataclass(frozen=True)
class Map:
    """Values over a plate, one for each rectangle between edges along each axis."""

    title: str
    edges_mm: tuple[Floats, ...]
    """(axes,), each (parts + 1,)."""
    values: Floats
    """(rectangles,), in the order of `places.grid_of`; not finite: nothing."""
    with_numbers: bool = True
    marked_mm: tuple[float, float] | None = None
    """A place with a mark."""


def draw_maps(maps: Sequence[Map], size_mm: tuple[float, ...], says: str, *, across: int = 1) -> str:
    """Draw maps of a plate, `across` in each row, each with its own shades from its least value to its largest."""
    width = WIDTH / across
    rows = -(-len(maps) // across)
    first = FromAbove.within(size_mm, 0.0, 0.0, width - GAP)
    height = TITLE + first.bottom + 14
    parts = [opening("chart", WIDTH, rows * height, says)]
    for number, one in enumerate(maps):
        row, column = divmod(number, across)
        px = FromAbove(size_mm, column * width + GAP / 2, row * height + TITLE, first.factor)
        parts += [text_at((px.left + px.right) / 2, round(px.top - 7, 1), one.title), *_shades(one, px)]
    return "\n".join([*parts, "</svg>"])


def _shades(one: Map, px: FromAbove) -> Iterable[str]:
    known = one.values[np.isfinite(one.values)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    along_x, along_y = one.edges_mm
    values = one.values.reshape(len(along_x) - 1, len(along_y) - 1)
    for (column, row), value in np.ndenumerate(values):
        x_mm = float(along_x[column]), float(along_x[column + 1])
        y_mm = float(along_y[row]), float(along_y[row + 1])
        share = (value - low) / (high - low) if high > low else 0.0
        if np.isfinite(value):
            yield px.area(f'{fill("s0")} opacity="{FAINTEST + (DARKEST - FAINTEST) * share:.2f}"', x_mm, y_mm)
        if one.with_numbers and (x_mm[1] - x_mm[0]) * px.factor >= NUMBER_PX:
            middle = px.x(sum(x_mm) / 2), round(px.y(sum(y_mm) / 2) + 4, 1)
            yield text_at(*middle, digits(float(value), 2) if np.isfinite(value) else "-")
    yield px.whole(stroke("muted", "frame"))
    if one.marked_mm is not None:
        yield _ring(px, one.marked_mm, "ink", 5.0)


def _ring(px: FromAbove, at_mm: tuple[float, float], colour: Colour, radius: float) -> str:
    paint = stroke(colour, "line", width=1.5)
    return f'<circle {paint} cx="{px.x(at_mm[0]):.1f}" cy="{px.y(at_mm[1]):.1f}" r="{radius:g}"/>'


@dataclass(frozen=True)
class Region:
    """The ellipse that holds 95 %, from the intervals of 95 % along both axes and their correlation."""

    place_mm: tuple[float, float]
    force_n: float
    deviation_mm: tuple[float, float]
    correlation: float

    @property
    def semi_axes_mm(self) -> tuple[float, float, float]:
        """The longer and the shorter half axis in mm, and the angle of the longer one to x, in rad."""
        (s, t), r = self.deviation_mm, self.correlation
        spectrum, vectors = np.linalg.eigh(np.array([[s * s, r * s * t], [r * s * t, t * t]]))
        half = np.sqrt(CHI_SQUARE_95 * np.maximum(spectrum, 0.0))
        return float(half[1]), float(half[0]), math.atan2(float(vectors[1, 1]), float(vectors[0, 1]))


def draw_regions(regions: Sequence[Region], size_mm: tuple[float, ...], says: str) -> tuple[str, float]:
    """Draw regions on a plate, larger by a round factor, which is returned, too."""
    px = FromAbove.within(size_mm, MARGIN, 12.0, WIDTH - 2 * MARGIN)
    longest = max(2 * region.semi_axes_mm[0] for region in regions)
    times = LARGEST * max(size_mm) / longest
    power = 10.0 ** math.floor(math.log10(times))
    times = max(1.0, max(step for step in (1, 2, 5) if step <= times / power) * power)
    parts = [opening("chart", WIDTH, px.bottom + LOWER, says), px.whole(stroke("muted", "frame"))]
    forces = sorted({region.force_n for region in regions})
    for region in regions:
        colour: Colour = "s0" if region.force_n == forces[-1] else "s1"
        long_px, short_px = (max(1.0, half * times * px.factor) for half in region.semi_axes_mm[:2])
        x, y, angle = px.x(region.place_mm[0]), px.y(region.place_mm[1]), -math.degrees(region.semi_axes_mm[2])
        dashes = ' stroke-dasharray="5 3"' if colour == "s1" else ""
        parts.append(
            f'<ellipse {stroke(colour, "line", width=1.6)}{dashes} cx="{x:.1f}" cy="{y:.1f}" rx="{long_px:.1f}" '
            f'ry="{short_px:.1f}" transform="rotate({angle:.1f} {x:.1f} {y:.1f})"/>'
        )
        parts.append(f'<circle {fill(colour)} cx="{x:.1f}" cy="{y:.1f}" r="1.8"/>')
    return "\n".join([*parts, *_ruler(px), "</svg>"]), times
