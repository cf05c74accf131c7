"""An influence function of a table, and what the table leaves unknown between its places.

Splines between few places make detail that nobody has measured: about a kink, as a string has at its load, they swing,
and a swing looks like information. So a table is trusted as far as it foretells itself: every fourth place is left out
in turn, and the root mean square of what the splines of the others miss there says how far they are off across twice
the distance. How it falls with the distance, the table and every other place of it say: as about its first power at
kinks, as its fourth where the structure is smooth (de Boor, A Practical Guide to Splines, 2001, chapter XII). So it is
taken to the distance of the places (Richardson's extrapolation), which gives the standard deviation of what the table
leaves open. For each sensor it is one number for all loads: one that changed along the structure would be detail again.
Of a string, a beam and a cantilever, with 9 to 81 places, it is 0.6 to 3 times what splines really are off.
"""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import RectBivariateSpline, make_interp_spline

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.physics.influence_function import InfluenceFunction, Interpolation, even_loads_mm
from beamtouch_models.design.scene import Scene
from beamtouch_models.errors import SceneError, require
from beamtouch_models.numbers import array_of, at_most, places_in
from beamtouch_models.places import positions_of

DEGREE = 3
"""Of the splines."""
APART = 4
"""Every so many places are left out at once; a spline forgets a place faster."""
FEWEST = 2 * APART
"""Places of a table from which the order is measured; with fewer, it is that of a kink."""
ORDERS = 1.0, 4.0
"""Powers of the distance with which the error of splines falls: about kinks, and of what is smooth."""
COARSE = 0.1
"""Largest part of the influence that a place left out may be missed by. A coarser table says too little to be used."""


def interpolate_influence(
    scene: Scene, sensor_mm: ArrayLike, load_mm: ArrayLike, matrix: ArrayLike
) -> InfluenceFunction:
    """Return an influence function that interpolates a table, for the contacts of a scene.

    The table is measured, or comes from another program. Between its entries, cubic splines interpolate. How far they
    may be off is part of the errors of samples: limits and layouts allow for it.

    Parameters
    ----------
    scene : states the contacts, and no beam: `change_scene(scene, beam=None)` takes one away
    sensor_mm : (sensors,) ascending positions of the table's columns, from 0 to the end of the structure, so that a
        sensor may stand anywhere. Over a support the entries are 0.
    load_mm : (loads,) ascending positions of its rows, at least over the range of the scene's contacts
    matrix : (loads, sensors) deflection in mm per newton

    Raises
    ------
    SceneError
        An argument is not as its line says, or the places are too far apart to be trusted; the message says how close
        they must be.

    Examples
    --------
    >>> places = np.linspace(0, 400, 41)
    >>> table = 0.5 * influence_matrix(scene, places, places)
    >>> measured = change_scene(scene, beam=None)
    >>> own = interpolate_influence(measured, places, places, table)
    >>> print(resolve(measured, influence=own).layout([130, 270]).limit(draws=500), "mm, as it yields half as much")
    6.12 +- 0.09 mm, as it yields half as much
    """
    require(scene, Scene, "scene", "what read_scene or make_scene returns")
    low, high = scene.contact.position_mm
    sensor, load, table = array_of(sensor_mm, "sensor_mm"), array_of(load_mm, "load_mm"), array_of(matrix, "matrix")
    length_mm = scene.beam.length_mm if scene.has_beam else float(sensor.max(initial=0.0))
    for name, places, start, end in (("sensor_mm", sensor, 0.0, length_mm), ("load_mm", load, low, high)):
        if places.ndim != 1 or len(places) < DEGREE or np.diff(places_in(places, name, length_mm)).min() <= 0:
            raise SceneError(f"{name}: give {DEGREE} or more ascending places")
        if places[0] > start or places[-1] < end:
            raise SceneError(f"{name}: give places from {start:g} mm, or less, to {end:g} mm, or more")
    if table.shape != (len(load), len(sensor)) or not np.isfinite(table).all() or not table.any():
        wanted = f"{len(load)} rows, one for each load, of {len(sensor)} finite numbers that are not all 0"
        raise SceneError(f"matrix: give {wanted}")
    spline = RectBivariateSpline(load, sensor, table, kx=min(DEGREE, len(load) - 1), ky=min(DEGREE, len(sensor) - 1))

    def at(sensor_mm: Floats, load_mm: Floats) -> Floats:
        values: Floats = spline(np.asarray(load_mm)[:, None], np.asarray(sensor_mm)[None, :], grid=False)
        return values

    loads_mm, unit = even_loads_mm(scene.contact.ranges_mm, [length_mm]), float(np.abs(table).max())
    left = _left_open(load, sensor, table)
    return InfluenceFunction(length_mm, loads_mm, scene.contact.force_range_n, at, unit, left)


def _left_open(load_mm: Floats, sensor_mm: Floats, table: Floats) -> Interpolation:
    """Return what a table leaves open between its rows and columns; SceneError if that is too much."""
    rows, columns = _missed(load_mm, table), _missed(sensor_mm, table.T).T
    influence, share = (np.sqrt(np.mean(np.square(one))) for one in (table, np.hypot(rows, columns)))
    worst, places, values = (
        ("load_mm", load_mm, table)
        if np.square(rows).sum() > np.square(columns).sum()
        else ("sensor_mm", sensor_mm, table.T)
    )
    spacing_mm, order = float(np.diff(places).max()), _order(places, values)
    nearer = [2.0 ** -_order(*along) for along in ((load_mm, table), (sensor_mm, table.T))]
    if share > COARSE * influence:
        needed_mm = spacing_mm * (COARSE * influence / share) ** (1 / order)
        raise SceneError(
            f"{worst}: places {digits(spacing_mm, 3)} mm apart are too coarse: splines of the others miss a place that "
            f"is left out by {digits(100 * share / influence, 2)} % of the influence, and more than {100 * COARSE:g} % "
            f"is not trusted; give one at every {at_most(needed_mm):g} mm"
        )
    of_rows, of_columns = (
        np.mean(np.square(factor * one), axis=0) for factor, one in zip(nearer, (rows, columns), strict=True)
    )
    return Interpolation(partial(_deviation, sensor_mm, of_rows, of_columns), spacing_mm, order)


def _deviation(column_mm: Floats, of_rows: Floats, of_columns: Floats, sensor_mm: Floats, load_mm: Floats) -> Floats:
    """Return the standard deviation (loads, sensors) of splines whose rows and columns have these mean squares."""
    sensor = positions_of(sensor_mm)
    index = np.clip(np.searchsorted(column_mm, sensor) - 1, 0, len(column_mm) - 2)
    share = (sensor - column_mm[index]) / (column_mm[index + 1] - column_mm[index])
    # A sensor at a column of the table is not between two of them.
    between = np.square(4 * share * (1 - share))
    variance = np.interp(sensor, column_mm, of_rows) + between * np.interp(sensor, column_mm, of_columns)
    deviation: Floats = np.tile(np.sqrt(variance), (len(load_mm), 1))
    return deviation


def _missed(places_mm: Floats, values: Floats) -> Floats:
    """Return by how much splines of the others miss the values (places, columns) at each place that is left out.

    What lies beyond an end of the others is not interpolated: an end has what its neighbour has.
    """
    missed, inner = np.empty_like(values), np.arange(1, len(places_mm) - 1)
    for first in range(APART):
        out = inner[first::APART]
        kept = np.setdiff1d(np.arange(len(places_mm)), out)
        spline = make_interp_spline(places_mm[kept], values[kept], k=min(DEGREE, len(kept) - 1))
        missed[out] = spline(places_mm[out]) - values[out]
    missed[[0, -1]] = missed[[1, -2]]
    return missed


def _order(places_mm: Floats, values: Floats) -> float:
    """Return the power of the distance with which `_missed` falls, from the table and every other place of it."""
    if len(places_mm) < FEWEST:
        return ORDERS[0]
    fine, coarse = (np.sqrt(np.mean(np.square(_missed(places_mm[::step], values[::step])))) for step in (1, 2))
    return ORDERS[1] if fine == 0 else float(np.clip(np.log2(coarse / fine), *ORDERS))
