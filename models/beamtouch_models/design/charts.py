"""Plain line charts as SVG text, and the colours and parts of all drawings: no dependency, the same bytes every time.

Colours are attributes of the elements, which every program understands. STYLE replaces them on a dark screen.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal

Colour = Literal["ground", "ink", "faint", "muted", "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7"]
LIGHT: dict[Colour, str] = {
    "ground": "#ffffff", "ink": "#1b1f24", "faint": "#d8dde3", "muted": "#59636e",
    "s0": "#0b62a8", "s1": "#c2410c", "s2": "#18794e", "s3": "#8e3a9e",
    "s4": "#8a6d00", "s5": "#5b6572", "s6": "#a8175b", "s7": "#0e7c86",
}  # fmt: skip
DARK: dict[Colour, str] = {
    "ground": "#14181d", "ink": "#e6e9ed", "faint": "#363d46", "muted": "#9aa4b0",
    "s0": "#6cb6ff", "s1": "#ff9a5c", "s2": "#56d39a", "s3": "#d99ae6",
    "s4": "#e0c04a", "s5": "#a9b4c0", "s6": "#ff85b6", "s7": "#5fd3dd",
}  # fmt: skip

# On a screen only: paper stays white.
STYLE = (
    "@media screen and (prefers-color-scheme: dark) {\n"
    + "".join(f".fill-{name} {{ fill: {value}; }} .stroke-{name} {{ stroke: {value}; }}\n"
              for name, value in DARK.items())
    + "}\n"
)  # fmt: skip
"""Style sheet for a page with drawings, or for the file of a single one."""
WIDTH, HEIGHT = 640, 340
LEFT, RIGHT, TOP, BOTTOM = 64, 16, 14, 46
LEGEND_ROW = 18
PANEL_WIDTH, PANEL_HEIGHT, PANEL_GAP = 215, 240, 14
"""Size of a chart in a row of charts, and the room between two, in px."""
TICK_ROOM = 30
"""Least distance of two labels of an axis, in px; a longer number needs more."""
CHARACTER = 6.4
"""Width of a character of the legend, in px; an estimate that only spaces the legend."""
SERIES_COLOURS: tuple[Colour, ...] = ("s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7")


def fill(colour: Colour, *names: str) -> str:
    """Return the attributes of a filled element; `names` are further classes."""
    return f'class="{" ".join((*names, f"fill-{colour}"))}" fill="{LIGHT[colour]}"'


def stroke(colour: Colour, *names: str, width: float = 1.0) -> str:
    """Return the attributes of an outlined element; `names` are further classes."""
    classes = " ".join((*names, f"stroke-{colour}"))
    return f'class="{classes}" fill="none" stroke="{LIGHT[colour]}" stroke-width="{width:g}"'


def opening(name: str, width: float, height: float, says: str) -> str:
    """Return the opening tag of a drawing, with a description for screen readers."""
    said = escape(says)
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" '
        f'font-family="system-ui, sans-serif" font-size="12" {fill("ink", name)} role="img" aria-label="{said}">'
        f"<title>{said}</title>"
    )


def standalone(svg: str) -> str:
    """Return a drawing as the text of an SVG file, with its own background."""
    head, rest = svg.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1).split("</title>", 1)
    ground = f'<rect {fill("ground")} width="100%" height="100%"/>'
    return f"{head}</title><style>{STYLE}</style>{ground}{rest}\n"


Style = Literal["line", "dashed", "points", "ring"]
"""A ring marks points that another series draws."""


@dataclass(frozen=True)
class Series:
    """One curve or one set of points."""

    label: str
    """Text in the legend; a series without a label is not listed."""
    x: Sequence[float]
    y: Sequence[float]
    colour: int = 0
    """0 .. 7."""
    style: Style = "line"
    errors: Sequence[float] = ()
    """Standard errors of y, drawn as bars; none: no bars."""


@dataclass(frozen=True)
class Chart:
    """A chart with its axes; logarithmic axes take positive values only."""

    says: str
    """Description for screen readers."""
    x_label: str
    y_label: str
    series: Sequence[Series]
    log_x: bool = False
    log_y: bool = False
    y_from_zero: bool = False
    x_range: tuple[float, float] | None = None
    """By default the axis spans the values."""
    whole_x: bool = False
    """True if x is a count, so that ticks are whole numbers."""


@dataclass(frozen=True)
class Axis:
    """A scale from values to pixels, with its ticks."""

    low: float
    high: float
    start_px: float
    end_px: float
    log: bool
    ticks: tuple[float, ...]

    def px(self, value: float) -> float:
        """Pixel of a value."""
        low, high, scaled = (
            (math.log10(v) for v in (self.low, self.high, value)) if self.log else (self.low, self.high, value)
        )
        return self.start_px + (scaled - low) / (high - low) * (self.end_px - self.start_px)


def draw(chart: Chart) -> str:
    """Draw a chart as an `<svg>` element, without a background; see `standalone`."""
    return _draw([chart], chart.says, (WIDTH - LEFT - RIGHT, HEIGHT - TOP - BOTTOM), 0)


def draw_row(charts: Sequence[Chart], says: str) -> str:
    """Draw charts side by side on one vertical axis, which is that of the first, with one legend above them.

    The legend has a label once, however many charts use it. `says` describes the whole for screen readers.
    """
    return _draw(charts, says, (PANEL_WIDTH, PANEL_HEIGHT), PANEL_GAP)


def _draw(charts: Sequence[Chart], says: str, size: tuple[int, int], gap: int) -> str:
    """Draw charts of a size in px, with a gap between two."""
    width = LEFT + len(charts) * size[0] + (len(charts) - 1) * gap + RIGHT
    every = [series for chart in charts for series in chart.series]
    named: dict[str, Series] = {}
    for series in every:
        named.setdefault(series.label, series)
    legend, rows = _legend(list(named.values()), width)
    top = TOP + rows * LEGEND_ROW
    bottom, log = top + size[1], charts[0].log_y
    ends = [end for series in every for value, error in _bars(series) for end in (value - error, value + error)]
    ends += [0.0] if charts[0].y_from_zero else []
    y = _axis([end for end in ends if end > 0 or not log], (bottom, top), log=log, margin=0.04)
    parts = [
        opening("chart", width, bottom + BOTTOM, says),
        f'<text transform="translate(15 {(top + bottom) / 2:g}) rotate(-90)" text-anchor="middle">'
        f"{escape(charts[0].y_label)}</text>",
    ]
    for place, chart in enumerate(charts):
        left = LEFT + place * (size[0] + gap)
        xs = chart.x_range or [value for series in chart.series for value in series.x]
        inner = (left + gap / 2, left + size[0] - gap / 2)
        x = _axis(xs, inner, log=chart.log_x, margin=0.0, least_step=float(chart.whole_x))
        parts += [
            *_grid(x, y, y_labels=place == 0),
            f'<text x="{left + size[0] / 2:g}" y="{bottom + BOTTOM - 8:g}" text-anchor="middle">'
            f"{escape(chart.x_label)}</text>",
            *(_series(series, x, y) for series in chart.series),
        ]
    return "\n".join([*parts, *legend, "</svg>"])


def _bars(series: Series) -> Iterable[tuple[float, float]]:
    return zip(series.y, series.errors or [0.0] * len(series.y), strict=True)


def _axis(
    values: Sequence[float], pixels: tuple[float, float], *, log: bool, margin: float, least_step: float = 0.0
) -> Axis:
    low, high = min(values), max(values)
    if log:
        low, high = low / 1.15, high * 1.15
        return Axis(low, high, *pixels, log, _log_ticks(low, high))
    if low == high:
        low, high = low - (abs(low) or 1) / 2, high + (abs(high) or 1) / 2
    room = margin * (high - low)
    low, high = low - room * (low != 0), high + room
    return Axis(low, high, *pixels, log, round_ticks(low, high, least_step))


def round_ticks(low: float, high: float, least_step: float = 0.0) -> tuple[float, ...]:
    """Return at most ten round values within low .. high."""
    rough = (high - low) / 6
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= rough * 0.999)
    step = max(step, least_step)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return tuple(index * step for index in range(first, last + 1))


def _log_ticks(low: float, high: float) -> tuple[float, ...]:
    """Return the powers of ten, with their multiples by 2 and 5 if there are few."""
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    factors = (1, 2, 5) if len(decades) <= 4 else (1,)
    stride = max(1, len(decades) // 8)
    values = (factor * 10.0**decade for decade in decades[::stride] for factor in factors)
    return tuple(value for value in values if low <= value <= high)


def _grid(x: Axis, y: Axis, *, y_labels: bool) -> Iterable[str]:
    left, right, bottom, top = x.start_px, x.end_px, y.start_px, y.end_px
    free = -math.inf
    for tick in x.ticks:
        tick_px, text = x.px(tick), f"{tick:g}"
        yield f'<line {stroke("faint", "grid")} x1="{tick_px:.1f}" x2="{tick_px:.1f}" y1="{bottom:g}" y2="{top:g}"/>'
        half = max(TICK_ROOM, CHARACTER * (len(text) + 2)) / 2
        if tick_px - half >= free:
            free = tick_px + half
            yield f'<text x="{tick_px:.1f}" y="{bottom + 17:g}" text-anchor="middle">{text}</text>'
    for tick in y.ticks:
        tick_px = y.px(tick)
        yield f'<line {stroke("faint", "grid")} x1="{left:g}" x2="{right:g}" y1="{tick_px:.1f}" y2="{tick_px:.1f}"/>'
        if y_labels:
            yield f'<text x="{left - 6:g}" y="{tick_px + 4:.1f}" text-anchor="end">{tick:g}</text>'
    size = f'width="{right - left:g}" height="{bottom - top:g}"'
    yield f'<rect {stroke("muted", "frame")} x="{left:g}" y="{top:g}" {size}/>'


def _series(series: Series, x: Axis, y: Axis) -> str:
    # Measured within its standard error, what is little may come out as nothing or less.
    points = [(x.px(a), y.px(max(b, y.low) if y.log else b)) for a, b in zip(series.x, series.y, strict=True)]
    bars = "".join(
        _bar(series, x.px(value), y, *bar) for value, bar in zip(series.x, _bars(series), strict=True) if bar[1]
    )
    if series.style == "ring":
        return "".join(_ring(*point) for point in points)
    if series.style == "points":
        paint = fill(SERIES_COLOURS[series.colour])
        return bars + "".join(f'<circle {paint} cx="{a:.1f}" cy="{b:.1f}" r="3.5"/>' for a, b in points)
    path = " ".join(f"{a:.1f},{b:.1f}" for a, b in points)
    return f'{bars}<polyline {_line(series)} points="{path}"/>'


def _ring(x_px: float, y_px: float) -> str:
    return f'<circle {stroke("ink", "line", width=1.5)} cx="{x_px:.1f}" cy="{y_px:.1f}" r="7"/>'


def _bar(series: Series, at_px: float, y: Axis, value: float, error: float) -> str:
    """Return a bar of a standard error to either side of a value, cut at the lower end of the axis."""
    low, high = (y.px(max(end, y.low)) for end in (value - error, value + error))
    paint = stroke(SERIES_COLOURS[series.colour], width=1.2)
    return f'<path {paint} d="M{at_px:.1f} {low:.1f}V{high:.1f}M{at_px - 3:.1f} {low:.1f}h6m-6 {high - low:.1f}h6"/>'


def _line(series: Series) -> str:
    """Return the attributes of a curve."""
    dashes = ' stroke-dasharray="6 4"' if series.style == "dashed" else ""
    paint = stroke(SERIES_COLOURS[series.colour], "line", width=1.8)
    return f'{paint} stroke-linejoin="round"{dashes}'


def _legend(series: Sequence[Series], width: float) -> tuple[list[str], int]:
    """Return the elements of the legend and its number of rows."""
    parts: list[str] = []
    row, offset = 0, 0.0
    for entry in series:
        if not entry.label:
            continue
        needed = 34 + len(entry.label) * CHARACTER
        if offset and offset + needed > width - LEFT - RIGHT:
            row, offset = row + 1, 0.0
        parts.append(_key(entry, LEFT + offset, TOP + row * LEGEND_ROW))
        offset += needed + 14
    return parts, row + 1 if parts else 0


def _key(series: Series, x: float, y: float) -> str:
    if series.style == "ring":
        mark = _ring(x + 13, y)
    elif series.style == "points":
        mark = f'<circle {fill(SERIES_COLOURS[series.colour])} cx="{x + 13:.1f}" cy="{y:.1f}" r="3.5"/>'
    else:
        mark = f'<line {_line(series)} x1="{x:.1f}" x2="{x + 26:.1f}" y1="{y:.1f}" y2="{y:.1f}"/>'
    return f'{mark}<text x="{x + 32:.1f}" y="{y + 4:.1f}">{escape(series.label)}</text>'
