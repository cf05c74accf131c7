"""Colours and parts of SVG drawings: no dependency, text kept as text.

Colours are attributes of the elements, which every program understands. STYLE replaces them on a dark screen.
"""

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
