"""Mistaken places in a scene: off the beam, in contradiction to each other, or in metres."""

from collections.abc import Iterator

from beamtouch_models.scene.beam import Beam
from beamtouch_models.scene.contact import Contact
from beamtouch_models.scene.sensors import Sensors

MM_PER_M = 1000


def misplaced(beam: Beam, contact: Contact, sensors: Sensors) -> str:
    """Return what to change in the first place that is clearly a mistake; empty if there is none."""
    return next(_misplaced(beam, contact, sensors), "")


def _misplaced(beam: Beam, contact: Contact, sensors: Sensors) -> Iterator[str]:
    length, on_the_beam = beam.length_mm, f"the beam, 0..{beam.length_mm:g} mm"
    yield from _in_metres(beam, contact, sensors)
    if contact.position_mm[0] < 0 or contact.position_mm[1] > length:
        yield f"contact.position_mm = {list(contact.position_mm)} reaches beyond {on_the_beam}"
    if contact.width_mm >= length:
        yield f"contact.width_mm = {contact.width_mm:g} must be less than beam.length_mm = {length:g}"
    if any(not 0 <= place <= length for place in sensors.fixed_mm):
        yield f"sensors.fixed_mm reaches beyond {on_the_beam}"
    for start, end in sensors.keep_out_mm:
        if end <= 0 or start >= length:
            yield f"sensors.keep_out_mm has [{start:g}, {end:g}], off {on_the_beam}; correct it, or remove it"
        for place in sensors.fixed_mm:
            if start < place < end:
                yield f"sensors: fixed_mm has {place:g} mm, within [{start:g}, {end:g}] of keep_out_mm; change one"


def _in_metres(beam: Beam, contact: Contact, sensors: Sensors) -> Iterator[str]:
    """Yield what to write for each list whose places, all next to the left end, are on the beam if they are metres."""
    stated: dict[str, list[float]] = {
        "beam.supports: at_mm": [] if isinstance(beam.supports, str) else [one.at_mm for one in beam.supports],
        "contact.position_mm": list(contact.position_mm),
        "sensors.fixed_mm": sensors.fixed_mm,
        **{f"sensors.keep_out_mm[{i}]": list(stretch) for i, stretch in enumerate(sensors.keep_out_mm)},
    }
    for key, places in stated.items():
        if 0 < max(places, default=0) <= beam.length_mm / MM_PER_M:
            given, right = (", ".join(f"{times * place:g}" for place in places) for times in (1, MM_PER_M))
            yield f"{key} = [{given}] is next to the left end of the beam; if it is in metres, write [{right}]"
