"""Deflection of prismatic spans in closed form, exact to a few units in the last place.

Textbook forms subtract nearly equal numbers when a load or a sensor is near a support. The forms here are products of
sums of positive terms: of the four distances to the ends and the distance between the two points, each computed
directly from positions in mm. Let p and q be the distances of the left point from the left and the right end, r and s
those of the right point, and d = r - p, all divided by the span's length l. The deflection in units of F l^3/(EI) is

    simply supported   p s (2 r s + d (p + r)) / 6
    cantilever         p^2 (2 r + d) / 6                                 fixed at the left
    fixed-fixed        p^2 s^2 (2 r q + d) / 6
    propped            p^2 s (q r (1 + s) + 2 (d + s r)) / 12            fixed at the left, simple at the right

With phi = EI/(k G A l^2), shear adds phi p s to a simply supported span and phi p to a cantilever, because their shear
forces follow from equilibrium alone. The other two forms need elements if shear is stated. Timoshenko & Gere, Mechanics
of Materials, 1972, sec. 12.12 (unit loads).

By reciprocity (Maxwell) either point may be the load. Rearranged from Young, Budynas & Sadegh, Roark's Formulas for
Stress and Strain, 8th ed., table 8.1, cases 1e, 1a, 1d, 1c; Gere & Goodno, Mechanics of Materials, app. H.
"""

import math
from typing import Literal, NamedTuple

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.scene.beam import SHEAR_COEFFICIENT, Beam

Form = Literal["simply-supported", "cantilever", "fixed-fixed", "propped"]

# Nodes of the two-point Gauss-Legendre rule on 0..1, exact for cubics, which deflections are.
GAUSS = ((1 - 1 / 3**0.5) / 2, (1 + 1 / 3**0.5) / 2)


class Span(NamedTuple):
    """A span with a closed form."""

    form: Form
    start_mm: float
    end_mm: float
    mirrored: bool
    """True if the form's left end is the right end of the span."""
    shear: float = 0.0
    """phi = EI/(k G A l^2); zero if the scene states no shear modulus."""

    @property
    def length_mm(self) -> float:
        """Distance between its ends."""
        return self.end_mm - self.start_mm


def span_of(beam: Beam, low_mm: float, high_mm: float) -> Span | None:
    """Return the span with a closed form that holds all positions from `low_mm` to `high_mm`; None if there is none.

    The beam beyond the supports of the span is unloaded then and does not affect its deflection.
    """
    if len({section[1:] for section in beam.sections}) > 1 or beam.foundation_n_mm2 is not None:
        return None
    span = _span(beam, low_mm, high_mm)
    section, modulus_gpa = beam.sections[0], beam.shear_modulus_gpa
    if span is None or modulus_gpa is None or section.area_mm2 is None:
        return span
    rigidity_n = SHEAR_COEFFICIENT * 1e3 * modulus_gpa * section.area_mm2
    compliance = section.rigidity_n_mm2 / span.length_mm / span.length_mm / rigidity_n if rigidity_n else math.inf
    is_determinate = span.form in {"simply-supported", "cantilever"}
    return span._replace(shear=compliance) if is_determinate and math.isfinite(compliance) else None


def _span(beam: Beam, low_mm: float, high_mm: float) -> Span | None:
    supports = beam.support_list
    if any(support.fixity for support in supports):
        return None
    if len(supports) == 1:
        wall = supports[0].at_mm
        if high_mm <= wall and wall > 0:
            return Span("cantilever", 0.0, wall, mirrored=True)
        return Span("cantilever", wall, beam.length_mm, mirrored=False) if low_mm >= wall else None
    if len(supports) > 2 or low_mm < supports[0].at_mm or high_mm > supports[1].at_mm:
        return None
    kinds = (supports[0].kind, supports[1].kind)
    form: Form = "propped"
    if kinds[0] == kinds[1]:
        form = "simply-supported" if kinds[0] == "simple" else "fixed-fixed"
    return Span(form, supports[0].at_mm, supports[1].at_mm, mirrored=kinds == ("simple", "fixed"))


def point_influence(span: Span, sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the influence of point loads (loads,) at sensors (sensors,) in a span; (loads, sensors) in l^3/(EI)."""
    x, a = sensor_mm[None, :], load_mm[:, None]
    return _deflection(span, (x - span.start_mm, span.end_mm - x), (a - span.start_mm, span.end_mm - a), np.abs(x - a))


def patch_influence(span: Span, sensor_mm: Floats, low_mm: Floats, high_mm: Floats) -> Floats:
    """Return the influence of even contacts from `low_mm` to `high_mm` (loads,); (loads, sensors) in l^3/(EI).

    As a function of the load's position, the deflection is a cubic on either side of the sensor. So the mean over a
    contact is two Gauss-Legendre sums of positive terms, which stay accurate for contacts of any width.
    """
    x, low, high = sensor_mm[None, :], low_mm[:, None], high_mm[:, None]
    at_sensor = (x - span.start_mm, span.end_mm - x)
    middle = np.clip(x, low, high)
    width = high - low
    total = np.zeros(np.broadcast_shapes(x.shape, low.shape))
    for start, end in ((low, middle), (middle, high)):
        # Both halves of a point have half of the force.
        share = np.divide(end - start, width, out=np.full(total.shape, 0.5), where=width > 0)
        for fraction in GAUSS:
            place = (
                (start - span.start_mm) * (1 - fraction) + (end - span.start_mm) * fraction,
                (span.end_mm - start) * (1 - fraction) + (span.end_mm - end) * fraction,
            )
            apart = np.abs(start - x) * (1 - fraction) + np.abs(end - x) * fraction
            total += share / 2 * _deflection(span, at_sensor, place, apart)
    return total


def _deflection(span: Span, x: tuple[Floats, Floats], a: tuple[Floats, Floats], apart_mm: Floats) -> Floats:
    """Return the deflection at x under a load at a, both given as distances from the left and the right end in mm."""
    length = span.length_mm
    x, a = (x[0] / length, x[1] / length), (a[0] / length, a[1] / length)
    left = np.minimum(x[0], a[0]), np.maximum(x[1], a[1])
    right = np.maximum(x[0], a[0]), np.minimum(x[1], a[1])
    if span.mirrored:
        left, right = right[::-1], left[::-1]
    (p, q), (r, s), d = left, right, apart_mm / length
    deflection: Floats
    if span.form == "simply-supported":
        deflection = p * s * ((2 * r * s + d * (p + r)) / 6 + span.shear)
    elif span.form == "cantilever":
        deflection = p * (p * (2 * r + d) / 6 + span.shear)
    elif span.form == "fixed-fixed":
        deflection = p * p * s * s * (2 * r * q + d) / 6
    else:
        deflection = p * p * s * (q * r * (1 + s) + 2 * (d + s * r)) / 12
    return deflection
