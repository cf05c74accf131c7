"""Faults of a table of measured loads: it is too sparse, loads contradict each other, or sensors do not repeat."""

from typing import NamedTuple

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.smooth_fit import SmoothFit
from beamtouch_models.places import in_words, positions_of

COARSE = {1: 0.1, 2: 0.4}
"""Largest part of the influence that may be unknown anywhere in the range of contacts, by the number of axes. A sensor
on a line that is known no better tells places hardly better than whether something touches. A skin has many sensors,
which together tell places by what each alone hardly does."""
UNSTEADY = 0.2
"""Largest part of the influence by which a load may differ when it is put on anew."""
MORE = 40
"""Largest number of further loads that a message asks for."""
SURELY = 8.0
"""Deviations from what the others say by which a load contradicts them."""
SO_MUCH = 0.1
"""And part of what a sensor shows by which it does."""
MANY, SURPRISING = 300, 6.0
"""Of more loads, one hardly changes what the others say, so that none is in question without such a deviation. Of
fewer, the worst one always is."""
ENOUGH = 8
"""Loads with which one that contradicts the others can be told, and scatter from too few of them."""
MOST = 20
"""Loads that a message names."""
ASKED = 210
"""Places, about, at which a message looks for those where further loads would help."""


class FittedAt(NamedTuple):
    """The influence at some places, and how well it is known there."""

    place_mm: Floats
    """(places, axes)"""
    mean: Floats
    """(places, sensors)"""
    deviation: Floats
    """(places, sensors)"""


def find_fault(
    fit: SmoothFit, values: Floats, force_n: Floats, contacts: FittedAt, names: tuple[str, ...], unit: str
) -> str:
    """Say why a table cannot be used, and what to do; empty if it can.

    Parameters
    ----------
    fit, values, force_n : the fit, the values (values, sensors) per newton that it is of, and their forces
    contacts : the fit at places of contacts
    names, unit : of the sensors
    """
    silent = [name for name, shown in zip(names, values.T, strict=True) if np.count_nonzero(shown) <= 1]
    if silent:
        return f"{silent[0]} shows 0 under all loads but one; check it, or take it out"
    largest = np.sqrt(np.mean(contacts.mean**2, axis=0))
    if message := _contradiction(fit, values, force_n, largest, names, unit):
        return message
    scattered = _scattered(fit, largest, names)
    if scattered and len(values) >= ENOUGH:
        return scattered
    share = _unknown(contacts.deviation**2, largest)
    if share.max() > COARSE[contacts.place_mm.shape[1]]:
        return _too_sparse(fit, contacts.place_mm, largest, share)
    return scattered


def _unknown(variance: Floats, largest: Floats) -> Floats:
    """Return the part of the influence (places,) of most sensors that is unknown, from its variance (places, sensors).

    A sensor of which nothing is known at some places has no say there; the others locate.
    """
    unknown: Floats = np.sqrt(np.median(variance / largest**2, axis=1))
    return unknown


def _contradiction(
    fit: SmoothFit, values: Floats, force_n: Floats, largest: Floats, names: tuple[str, ...], unit: str
) -> str:
    """Say which loads contradict the others; empty if none does.

    Loads that are wrong make all seem to scatter, which hides others, so the search goes on without those that it has.
    """
    wrong, suspects, count = list[str](), list[int](), len(values)
    while new := _suspects(fit, min(MOST, count // ENOUGH) - len(suspects)):
        suspects += new
        rest = values.copy()
        rest[suspects] = np.nan
        fit = SmoothFit.of(fit.place_mm, rest, force_n)
        before = len(wrong)
        for suspect, mean, deviation in zip(new, *fit.at(fit.place_mm[new]), strict=True):
            off = np.fmin(np.abs(values[suspect] - mean), _off_a_side(fit.place_mm, values, suspect))
            off[np.isnan(values[suspect])] = 0.0
            scatter = np.hypot(deviation, fit.scatter_under(float(force_n[suspect])))
            worst = int((off / scatter).argmax())
            if off[worst] > max(SURELY * scatter[worst], SO_MUCH * largest[worst]):
                load = f"the load at {in_words(fit.place_mm[suspect])} mm with {force_n[suspect]:g} N"
                both = values[suspect, worst], mean[worst]
                shown, said = (digits(float(per_newton * force_n[suspect]), 3) for per_newton in both)
                wrong.append(f"under {load}, {names[worst]} shows {shown} {unit}, but the others say {said}")
        if len(wrong) == before:
            break
    if not wrong:
        return ""
    again = "measure it again, or take it out"
    if len(wrong) > 1:
        again = "measure each of these loads again, or take them out"
    return f"{'; '.join(wrong)}; {again}"


def _suspects(fit: SmoothFit, most: int) -> list[int]:
    """Return the loads that may contradict the others, each found while those before it are left out.

    One that is far off makes its neighbours surprising. Without it, they are not.
    """
    suspects = list[int]()
    while len(suspects) < most:
        surprises = np.abs(fit.left_out).max(axis=1)
        worst = int(surprises.argmax())
        if surprises[worst] < SURPRISING and (suspects or len(surprises) > MANY):
            break
        suspects.append(worst)
        fit = fit.without(worst)
    return suspects


def _off_a_side(place_mm: Floats, values: Floats, index: int) -> Floats:
    """Return by how much the values of a place (columns,) miss the straight line through its neighbours on one side.

    A load that stands on a kink, as under a string or above a strain gauge, surprises a smooth fit, but it lies on the
    line of one of its sides. A load that is wrong lies on neither.
    """
    off: Floats = np.full(values.shape[1], np.inf)
    if place_mm.shape[1] > 1:
        return off
    along = positions_of(place_mm)
    here, distance = along[index], along - along[index]
    for side in (distance < 0, distance > 0):
        beside = np.unique(along[side])
        near, next_to_it = beside[np.abs(beside - here).argsort()[:2]] if len(beside) > 1 else (here, here)
        if near != next_to_it:
            first, second = (values[along == place].mean(axis=0) for place in (near, next_to_it))
            line = first + (first - second) * (here - near) / (near - next_to_it)
            off = np.fmin(off, np.abs(values[index] - line))
    return off


def _scattered(fit: SmoothFit, largest: Floats, names: tuple[str, ...]) -> str:
    """Say which sensor shows something else each time; empty if none does."""
    scatter = fit.repeatability / largest
    worst = int(scatter.argmax())
    if scatter[worst] <= UNSTEADY:
        return ""
    if (scatter > UNSTEADY).all():
        return (
            f"all sensors repeat to {digits(100 * scatter.min(), 2)} % of what they show or worse, as if loads did not "
            "stand where the table says, or had other forces; correct the table, measure again, or state curved = true "
            "if heavy loads show less or more per newton than light ones"
        )
    return (
        f"{names[worst]} repeats to {digits(100 * scatter[worst], 2)} % of what it shows only, as if loads did not "
        f"stand where the table says; measure again what differs, or take {names[worst]} out"
    )


def _too_sparse(fit: SmoothFit, contact_mm: Floats, largest: Floats, share: Floats) -> str:
    """Say where the loads are too far apart, and how many more would do."""
    coarse, worst, axes = COARSE[contact_mm.shape[1]], int(share.argmax()), contact_mm.shape[1]
    asked, more = contact_mm[:: max(1, len(contact_mm) // ASKED)], np.empty((0, axes))
    unknown, there = share[worst], contact_mm[worst]
    while unknown > coarse and len(more) < MORE:
        more = np.vstack([more, there])
        shares = _unknown(fit.variance_with(more, asked), largest)
        unknown, there = shares.max(), asked[shares.argmax()]
    would = f"{len(more)} loads more would do" if unknown <= coarse else f"more than {MORE} loads more are needed"
    told = ", ".join(in_words(place) for place in sorted(more[:3].round().tolist()))
    percent = digits(100 * share[worst], 2)
    key = "contact.position_mm" if axes == 1 else "contact.x_mm and y_mm"
    return (
        f"the loads are too far apart for {key}: at {in_words(contact_mm[worst])} mm, {percent} % of the influence is "
        f"unknown, and more than {100 * coarse:g} % is not trusted; {would}, first at {told} mm, or narrow {key}"
    )
