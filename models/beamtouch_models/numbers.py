"""The arguments that scripts give, checked, and the bounds that messages name."""

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context

import numpy as np
from numpy.typing import ArrayLike

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.errors import SceneError


def numbers(values: ArrayLike, name: str, *, least: float = -math.inf, most: float = math.inf) -> Floats:
    """Return numbers as an array (values,); SceneError unless they are finite and from `least` to `most`."""
    array = np.atleast_1d(array_of(values, name))
    if array.ndim != 1 or array.size == 0:
        raise SceneError(f"{name}: must be one number, or a list of them that is not empty")
    wrong = array[~(np.isfinite(array) & (array >= least) & (array <= most))]
    if wrong.size:
        bounds = (
            f" from {least:g} to {most:g}" if most < math.inf else f", at least {least:g}" if least > -math.inf else ""
        )
        raise SceneError(f"{name}: must be finite{bounds} (given: {wrong[0]:g})")
    return array


def array_of(values: ArrayLike, name: str) -> Floats:
    """Return values as an array of any shape; SceneError unless they are numbers, in rows of one length."""
    try:
        given = np.asarray(values)
        if given.dtype.kind in "biuf":
            return given.astype(np.float64)
    except (TypeError, ValueError):  # rows of several lengths
        pass
    raise SceneError(f"{name}: must be numbers (given: {repr(values)[:40]})")


def number(value: object, name: str) -> float:
    """Return a number; SceneError unless it is a single one, and finite."""
    checked = numbers(value, name)  # type: ignore[arg-type]  # it says what is wrong with others
    if checked.size != 1:
        raise SceneError(f"{name}: must be one number")
    return float(checked[0])


def places_in(values: ArrayLike, name: str, length_mm: float) -> Floats:
    """Return places on a beam of this length as an array (places,); SceneError if one is not on it."""
    return numbers(values, name, least=0.0, most=length_mm)


def places_within(values: ArrayLike, name: str, low_mm: Floats, high_mm: Floats) -> Floats:
    """Return places (places, axes) within bounds (axes,); SceneError if one is not. Those of a beam are positions."""
    if len(low_mm) == 1:
        return numbers(values, name, least=float(low_mm[0]), most=float(high_mm[0]))[:, None]
    places = np.atleast_2d(array_of(values, name))
    if places.ndim != 2 or places.shape[1] != len(low_mm) or not len(places):
        raise SceneError(f"{name}: give {len(low_mm)} numbers for each place, x and y")
    for axis, column in enumerate(places.T):
        numbers(column, name, least=float(low_mm[axis]), most=float(high_mm[axis]))
    return places


def whole(value: object, name: str, least: int) -> int:
    """Return a whole number; SceneError unless it is one, and at least `least`."""
    integer = int(value) if isinstance(value, int | np.integer) and not isinstance(value, bool) else None
    if integer is None or integer < least:
        raise SceneError(f"{name} = {repr(value)[:40]}: give a whole number, {least} or more")
    return integer


def with_error(value: float, standard_error: float, sign: str = "+-", unit: str = "") -> str:
    """Return a measured value to the digit that its standard error leaves, at most four, and the error.

    >>> with_error(4.7123, 0.0812, unit=" mm")
    '4.71 +- 0.08 mm'
    >>> with_error(1.00002, 0.0000031)
    '1.000 +- <0.001'
    """
    if not (math.isfinite(value) and 0 < standard_error < math.inf):
        return f"{digits(value, 3)}{unit}"
    least = math.floor(math.log10(abs(value))) - 3 if value else -3
    place = max(math.floor(math.log10(float(f"{standard_error:.1g}"))), least)
    error = digits(standard_error, 1) if standard_error >= 0.5 * 10.0**place else f"<{digits(10.0**place, 1)}"
    return f"{value:.{max(0, -place)}f} {sign} {error}{unit}"


def rounded(value: float, standard_error: float) -> str:
    """Return a measured value to the digit that its standard error leaves, without the error."""
    return with_error(value, standard_error).split(" ")[0]


def at_most(value: float) -> float:
    """Return the largest number with two digits that is not more than a value."""
    return _two_digits(value, ROUND_FLOOR)


def at_least(value: float) -> float:
    """Return the smallest number with two digits that is not less than a value; infinity beyond the largest float."""
    return _two_digits(value, ROUND_CEILING)


def _two_digits(value: float, way: str) -> float:
    # In decimals, because in floats 0.29 is 28.999... hundredths.
    return float(Context(prec=2, rounding=way).create_decimal(repr(float(value))))
