"""A fit in words: each departure of a real surface from its scene, with its standard error and unit. Pure."""

from collections.abc import Mapping, Sequence

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.units import MM
from beamtouch_models.arrays import Floats
from beamtouch_models.design.calibration.nominal_surface import SPRING
from beamtouch_models.design.surface import resolve_model
from beamtouch_models.runtime.departures import Departures
from beamtouch_models.runtime.metadata import Metadata

HARDLY = 0.6
"""Error of the stiffness of a spring, over what is plausible before any load, from which loads tell little of it."""


def scale_in_words(value: float, error: float) -> str:
    """Return how much more a beam deflects per newton, relatively, with its standard error, as text."""
    percent = f"{digits(100 * abs(value), 3)} +- {digits(100 * error, 2)} % {'less' if value < 0 else 'more'}"
    return f"deflects {percent} per newton than the scene says: rigidity, gains or forces"


def departures_in_words(metadata: Metadata, found: Departures, errors: Mapping[str, Floats]) -> dict[str, str]:
    """Return each kind of departure with its standard errors, in the units of the departures, as text."""

    def each(values: list[float], spread: Floats, factor: float = 1.0, centre: float = 0.0) -> str:
        return _each(metadata, (np.array(values) - centre) * factor, spread * factor)

    shown = {
        "rigidity": f"{(found.rigidity - 1) * 100:+.2f} +- {errors['rigidity'][0] * 100:.2f} %",
        "gain": f"{each(found.gain, errors['gain'], 100.0, 1.0)} %",
    }
    if "position" in errors:
        shown["position"] = f"{each(found.position_offset_mm, errors['position'])} mm"
    if "x" in errors and found.across_offset_mm is not None:
        shown["x"] = f"{each(found.position_offset_mm, errors['x'])} mm"
        shown["y"] = f"{each(found.across_offset_mm, errors['y'])} mm"
    if "springs" in errors and found.spring_stiffness is not None:
        shown["springs"] = _springs_in_words(metadata, found.spring_stiffness, errors["springs"])
    shown["curve"] = f"{found.curve_per_mm:+.4f} +- {errors['curve'][0]:.4f} per {metadata.unit}"
    shown["offset"] = each_fine(metadata, 1e3 * np.array(found.offset_mm), 1e3 * errors["offset"])
    if "fixity" in errors:
        ends = zip(found.fixity, errors["fixity"], strict=True)
        left, right = (f"{value:.3f} +- {error:.3f}" for value, error in ends)
        shown["fixity"] = f"left {left}, right {right}"
    return shown


def _springs_in_words(metadata: Metadata, stiffness: Sequence[float], errors: Floats) -> str:
    """Return by how much each spring of a plate is stiffer than all of them are in common.

    Springs that the loads hardly tell from gains are as uncertain as before them.
    """
    plate = resolve_model(metadata).scene.plate
    supports = () if plate is None else plate.support_list
    sprung = [place for place, one in enumerate(supports) if one.stiffness_n_per_mm is not None]
    texts = [
        f"{place + 1} {100 * (stiffness[place] - 1):+.2f} +- {100 * error:.2f}"
        for place, error in zip(sprung, errors.tolist(), strict=True)
    ]
    hardly = "; these loads hardly tell them from gains" if min(errors) > HARDLY * SPRING else ""
    return f"{', '.join(texts)} %{hardly}"


def each_fine(metadata: Metadata, values_um: Floats, errors_um: Floats) -> str:
    """Return the zero of each channel, given in um, with its error and unit, as text."""
    if metadata.unit == MM:
        return f"{_each(metadata, values_um, errors_um)} um"
    texts = (
        f"{channel.name} {digits(1e-3 * value, 3)} +- {digits(1e-3 * error, 2)}"
        for channel, value, error in zip(metadata.layout, values_um, errors_um, strict=True)
    )
    return f"{', '.join(texts)} {metadata.unit}"


def _each(metadata: Metadata, values: Floats, errors: Floats) -> str:
    """Return the value of each channel with its error, as text."""
    return ", ".join(
        f"{channel.name} {value:+.2f} +- {error:.2f}"
        for channel, value, error in zip(metadata.layout, values, errors, strict=True)
    )


def percent_of(values: Sequence[float]) -> str:
    """Return relative errors as one number, or as their range."""
    low, high = (digits(100 * end(values), 2) for end in (min, max))
    return f"{low} %" if low == high else f"{low}..{high} %"
