"""Remarks on the table of a measured structure that may be right: units, signs, copies, and places that are guessed."""

from collections.abc import Iterator

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.units import MM
from beamtouch_models.design.scene.measured import Measured
from beamtouch_models.design.scene.measured_loads import MeasuredLoads
from beamtouch_models.design.scene.tables import Contact
from beamtouch_models.places import Place, in_words

MUCH, LITTLE_MM = 0.1, 0.005
"""A structure that bends by more than this part of its length, or by less than this, was probably stated in another
unit."""
OTHER_FORCE = 5.0
"""Forces of loads and of contacts that differ by more than this are probably in different units."""


def remarks_on_table(measured: Measured, contact: Contact) -> Iterator[str]:
    """Yield what to look at again in a table, and which places of sensors are guessed."""
    loads = measured.loads
    if loads.unit == MM:
        yield from _on_size(loads, max(measured.size_mm), contact.force_range_n[1])
        shown = loads.influence_mm_per_n
        if (np.nanmax(shown, axis=0) < -np.nanmin(shown, axis=0)).all():
            yield (
                "all sensors of the table show their largest deflections against the load; deflections are positive in "
                "the direction of the load, so if it comes nearer to the sensors, change the signs"
            )
    if not loads.is_per_newton:
        yield from _on_forces(loads, contact)
        yield from _on_copies(loads)
    if not measured.sensors_mm:
        places = ", ".join(f"{name} {_rounded(place)}" for name, place in measured.places_mm.items())
        yield (
            "the table does not say where sensors stand, so each is drawn where it shows most: "
            f"{places} mm; answers do not depend on it, but drawings and the order of sensors do; state "
            "measured.sensors_mm in a scene"
        )


def _on_size(loads: MeasuredLoads, length_mm: float, strongest_n: float) -> Iterator[str]:
    """Yield what the size of the deflections says of their unit."""
    bent_mm = float(np.nanmax(np.abs(loads.influence_mm_per_n))) * strongest_n
    if bent_mm > MUCH * length_mm:
        yield (
            f"by its table, the structure bends by {digits(bent_mm, 3)} mm over {length_mm:g} mm; if the table is "
            "in um, divide its deflections by 1000"
        )
    if bent_mm < LITTLE_MM:
        yield (
            f"by its table, the structure bends by {digits(1e3 * bent_mm, 3)} um only; if the table is in m, "
            "multiply its deflections by 1000; if it is in another unit, name it, as s1_deflection_uV/V"
        )


def _on_forces(loads: MeasuredLoads, contact: Contact) -> Iterator[str]:
    """Yield a doubt about the unit of the forces, which only those of the contacts can raise."""
    weak, strong = contact.force_range_n
    least, most = float(loads.force_n.min()), float(loads.force_n.max())
    if least > OTHER_FORCE * strong or OTHER_FORCE * most < weak:
        yield (
            f"the loads of the table have {digits(least, 3)} to {digits(most, 3)} N, but contact.force_n is {weak:g} "
            f"to {strong:g} N; if the loads are in g, 100 g weigh 0.981 N; if they are in kg, 1 kg weighs 9.81 N"
        )


def _on_copies(loads: MeasuredLoads) -> Iterator[str]:
    """Yield a doubt about loads that are equal to the last digit."""
    rows = np.column_stack([loads.place_mm, loads.force_n, loads.deflection_mm])
    _, first, times = np.unique(rows, axis=0, return_index=True, return_counts=True)
    if (times > 1).any():
        copied = first[times > 1].min()
        load = f"{in_words(loads.place_mm[copied])} mm with {loads.force_n[copied]:g} N"
        yield (
            f"{int(times.max())} loads at {load} are equal to the last digit, as copied rows "
            "are; if they are copies, take them out: they hide how well loads repeat"
        )


def _rounded(place: Place) -> str:
    """Return a place to four digits."""
    return in_words([float(digits(number, 4)) for number in np.atleast_1d(place)])
