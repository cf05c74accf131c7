"""Symbols of supports in a drawing of a beam."""

from beamtouch_models.scene.beam_parts import Support
from beamtouch_models.svg import stroke

WALL = 28
"""Height of a wall above the underside of the beam, in px."""


def support_in_words(support: Support) -> str:
    """Return a kind of support in the words of an engineer."""
    if support.kind == "fixed":
        return "clamped" if support.holds_lengthwise else "clamped, can slide"
    turns = "can turn against a spring" if support.fixity else "can turn"
    return f"pinned: {turns}, not slide" if support.holds_lengthwise else f"roller: {turns} and slide"


def support_symbol(support: Support, x: float, underside: float, top: float, *, at_start: bool, name: str) -> str:
    """Draw a support of a beam between two heights as a single path; `name` is its class."""
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
    return f'<path {stroke("ink", name, width=1.4)} d="{parts}"/>'


def _ground(x: float, y: float, depth: float) -> str:
    hatches = "".join(f" M{x - 8 + 7 * i:.1f} {y:.1f} l-5 {depth:g}" for i in range(4))
    return f"M{x - 13:.1f} {y:.1f} h26{hatches}"


def _circle(x: float, y: float, r: float) -> str:
    return f"M{x - r:.1f} {y:.1f} a{r:g} {r:g} 0 1 0 {2 * r:g} 0 a{r:g} {r:g} 0 1 0 {-2 * r:g} 0"
