"""The legend of a drawing of a beam: every symbol and every colour in it has its words."""

from collections.abc import Callable, Iterator, Sequence
from html import escape

from beamtouch_common.digits import digits
from beamtouch_models.building.report.beam_scale import Scale, rect
from beamtouch_models.building.report.beam_symbols import support_in_words, support_symbol
from beamtouch_models.metadata import Metadata
from beamtouch_models.scene import Scene
from beamtouch_models.scene.beam_parts import Support
from beamtouch_models.svg import fill, stroke

CHARACTER = 6.4
"""Width of a character, in px; an estimate that only spaces the legend."""
ROW, KEY, GAP = 30, 40, 24
"""Height of a row, width of a symbol, and space between two entries, in px."""
BENT = stroke("s1", "bent", width=1.4) + ' stroke-dasharray="5 3"'
SPRING = stroke("ink", "support", width=1.4)

Entry = tuple[Callable[[float, float], str], str]
"""How a symbol is drawn about a place, and its words."""


def keys(scene: Scene, metadata: Metadata, px: Scale) -> Iterator[Entry]:
    """Yield the entries of the legend, for what the drawing shows."""
    known = [one for one in px.thickness_mm if one]
    each = " and ".join(f"{one:g}" for one in sorted(set(known))) if len(set(known)) < 4 else "in steps"
    thick = f"{each} mm thick" if each else "thickness not stated"
    yield _beam_key, thick if px.thicker == 1 or not known else f"{thick}, drawn {digits(px.thicker, 2)} times thicker"
    for words, support in {support_in_words(one): one for one in scene.beam.support_list}.items():
        yield _support_key(support), words
    fixed = set(scene.sensors.fixed_mm)
    kinds = {channel.position_mm in fixed for channel in metadata.layout}
    wide = f", {scene.sensors.size_mm:g} mm wide" if scene.sensors.size_mm else ""
    for is_fixed, words in ((False, f"sensor{wide}"), (True, f"sensor{wide}, fixed by the scene")):
        if is_fixed in kinds:
            yield _sensor_key(is_fixed=is_fixed), words
    if scene.sensors.keep_out_mm:
        yield _keep_out_key, "no sensors here"
    if scene.beam.foundation_n_mm2 is not None:
        yield _spring_key, "elastic foundation"


def _beam_key(x: float, y: float) -> str:
    return rect(fill("muted", "key"), x - 16, y - 2, 32, 4)


def bent_key(x: float, y: float) -> str:
    """Draw the symbol of the bent beam."""
    return f'<path {BENT} d="M{x - 16:.1f} {y - 4:.1f} q16 12 32 0"/>'


def _sensor_key(*, is_fixed: bool) -> Callable[[float, float], str]:
    paint = fill("s3" if is_fixed else "s0", "key")
    return lambda x, y: rect(paint, x - 5, y - 9, 10, 18)


def _keep_out_key(x: float, y: float) -> str:
    return rect(f'{fill("s1", "key")} opacity=".16"', x - 16, y - 9, 32, 18)


def _spring_key(x: float, y: float) -> str:
    return f'<path {stroke("ink", "key", width=1.4)} d="M{x:.1f} {y - 6:.1f} l3 3 l-6 3 l6 3 l-3 3" opacity=".45"/>'


def _support_key(support: Support) -> Callable[[float, float], str]:
    def draw(x: float, y: float) -> str:
        beam = rect(fill("muted", "key"), -16, -11, 32, 3)
        at = -16 if support.kind == "fixed" else 0
        symbol = support_symbol(support, at, -8, -11, at_start=True, name="key")
        return f'<g transform="translate({x:.1f} {y + 3:.1f}) scale(0.75)">{beam}{symbol}</g>'

    return draw


def legend(entries: Sequence[Entry], left: float, right: float, top: float) -> tuple[list[str], int]:
    """Return the elements of a legend between two edges, and its number of rows."""
    rows = list(_rows(entries, right - left))
    parts = []
    for number, row in enumerate(rows):
        y = top + number * ROW
        for offset, (symbol, words) in row:
            x = left + offset
            parts += [symbol(x + KEY / 2, y), f'<text x="{x + KEY + 4:.1f}" y="{y + 4:.1f}">{escape(words)}</text>']
    return parts, len(rows)


def _rows(entries: Sequence[Entry], width: float) -> Iterator[list[tuple[float, Entry]]]:
    """Yield rows of entries, each with its offset."""
    row: list[tuple[float, Entry]] = []
    offset = 0.0
    for entry in entries:
        wide = KEY + 4 + len(entry[1]) * CHARACTER + GAP
        if row and offset + wide - GAP > width:
            yield row
            row, offset = [], 0.0
        row.append((offset, entry))
        offset += wide
    if row:
        yield row
