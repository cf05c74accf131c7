"""The scale of a drawing of a beam, and the places of its parts in px."""

from html import escape

import numpy as np

from beamtouch_models.scene.beam import Beam

WIDTH, HEIGHT, MARGIN = 900, 236, 48
"""Size of the drawing without its legend, and space beside the beam."""
BEAM_Y = 92
"""Underside of the beam."""
THINNEST_PX, THICKEST_PX = 3.0, 40.0
"""A thin beam is drawn thicker until its thinnest section has the first or its thickest the second."""


class Scale:
    """From mm to px, the same along and across the beam; a thin beam is drawn thicker."""

    def __init__(self, beam: Beam) -> None:
        self.length_mm = beam.length_mm
        self.factor = (WIDTH - 2 * MARGIN) / beam.length_mm
        self.thickness_mm = _thicknesses_mm(beam)
        known = [one for one in self.thickness_mm if one]
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
        index = min(int(np.searchsorted(ends, at_mm)), len(ends) - 1)
        return BEAM_Y - self.height(self.thickness_mm[index])


def _thicknesses_mm(beam: Beam) -> list[float | None]:
    """Return the thickness of each section; None if the scene does not state it."""
    return [segment.thickness_mm or beam.thickness_mm for segment in beam.segments] or [beam.thickness_mm]


def rect(paint: str, x: float, y: float, width: float, height: float) -> str:
    """Return a rectangle."""
    return f'<rect {paint} x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"/>'


def text_at(x: float, y: float, text: str) -> str:
    """Return a text centred at x."""
    return f'<text x="{x:.1f}" y="{y:g}" text-anchor="middle">{escape(text)}</text>'
