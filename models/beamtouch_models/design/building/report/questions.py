"""Questions of a customer before signing, with the model's answers in short sentences; `code` is in backticks."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.outline import names_of
from beamtouch_common.units import MM, direction_of
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.building.report.parts import typeset
from beamtouch_models.design.physics.stress import largest_stress_mpa
from beamtouch_models.design.pricing.walk import walk_of
from beamtouch_models.design.scene.materials import MATERIALS
from beamtouch_models.design.surface import Surface
from beamtouch_models.numbers import at_least, rounded
from beamtouch_models.places import in_words
from beamtouch_models.runtime.description import nothing_seen, per_day, unseen
from beamtouch_models.runtime.force_range import ForceRange
from beamtouch_models.runtime.metadata import FORCE_OUTPUTS, Metadata, fewest_that_check

TRIED, MUST_HOLD = 20, 17
"""Contacts of an acceptance, and how many of their places must lie in the intervals. Of 20 intervals of 95 %, 17 or
more hold in 98 % of all trials."""


@dataclass(frozen=True)
class Question:
    """A question and its answer."""

    asked: str
    answer: str


@dataclass(frozen=True)
class Overload:
    """The smallest forces, wherever they press, at which something happens to a sensor."""

    leaves_range_n: float
    """A sensor leaves its linear range."""
    touches_n: float
    """The beam touches a sensor; infinite if it moves away from all."""


def overload_of(metadata: Metadata) -> Overload:
    """Return the forces beyond which sensors leave their range and the beam touches one; deflections are linear."""
    influence, sensor = np.array(metadata.influence.mm_per_n), metadata.sensor
    near, far = max(float(influence.max()), 0.0), max(float(-influence.min()), 0.0)
    if direction_of(metadata.unit) > 0:
        near, far = far, near
    room_mm = sensor.standoff_mm - sensor.range_mm[0], sensor.range_mm[1] - sensor.standoff_mm
    leaves_n = [room / moved for room, moved in zip(room_mm, (near, far), strict=True) if moved]
    touches = metadata.unit == MM and near > 0
    return Overload(min(leaves_n, default=np.inf), sensor.standoff_mm / near if touches else np.inf)


def noun_of(metadata: Metadata) -> Literal["beam", "plate"]:
    """Return the word for the structure, whatever it is made of: by its axes."""
    return "beam" if len(metadata.axes) == 1 else "plate"


def _states_force(metadata: Metadata) -> bool:
    return set(FORCE_OUTPUTS) <= set(metadata.golden.answers)


def _forces(metadata: Metadata) -> str:
    """Return the forces of the scene."""
    weak, strong = metadata.ranges.force_n
    return f"{weak:g} N" if weak == strong else f"{weak:g} to {strong:g} N"


def can(metadata: Metadata, force_error_n: Measurement | None) -> list[str]:
    """Return what the surface does, beside finding places; `force_error_n` is the mean |error| of force."""
    accuracy, count = metadata.accuracy, len(metadata.layout)
    first, usual = accuracy.since_touch[0], metadata.filter.window
    settled = next((one for one in accuracy.since_touch if one.readings >= usual), first)
    told = [f"It answers {digits(first.since_ms, 3)} ms after a touch"]
    if metadata.filter.kind == "growing-mean":
        told[0] += ", and the answer sharpens while the load rests"
    if settled is not first:
        told[0] += f"; {digits(settled.since_ms, 3)} ms after the {noun_of(metadata)} is still, it is as good as stated"
    if force_error_n is not None:
        off_n = rounded(force_error_n.value, force_error_n.standard_error)
        told.append(f"It states the force, too: off by {off_n} N on average, where it is {_forces(metadata)}")
    spare = count - metadata.min_channels
    if spare:
        told.append(f"It goes on with {spare} of {count} sensors failed, less accurately")
    often = per_day(metadata.thresholds.false_contacts_per_day)
    told.append(f"While nothing touches, it states a contact that is not there: {often}, on average")
    return [f"{sentence}." for sentence in told]


def cannot(metadata: Metadata) -> list[str]:
    """Return what the surface does not do."""
    missed, nothing = unseen(metadata), nothing_seen(metadata)
    told = [text[:1].upper() + text[1:] for text in (missed or nothing,) if text]
    if metadata.min_channels == len(metadata.layout):
        told.append("It does not go on when a sensor fails: every one of them must work")
    told.append("It finds one contact. It gives no place for two at once, and not the shape of a load that is spread")
    told.append("It is no safety device: do not let it stop a machine that could hurt someone")
    return [f"{sentence}." for sentence in told]


def questions(
    surface: Surface,
    metadata: Metadata,
    ends_mm: Sequence[float],
    middle_mm: float,
    accepted_mm: float,
) -> list[Question]:
    """Return the questions with their answers.

    `ends_mm` are the mean errors in the first and the last stretch of a beam, or along the rim and in the corners of a
    plate, `middle_mm` that in its middle, `accepted_mm` what the mean error of `TRIED` contacts exceeds in one of
    twenty trials.
    """
    noun = noun_of(metadata)
    asked = [
        ("What if the force is larger?", _larger(metadata)),
        (f"What happens {'at the ends' if noun == 'beam' else 'along the rim'}?", _ends(metadata, ends_mm, middle_mm)),
        (f"What happens while the {noun} rings?", _ringing(surface, noun)),
        ("What if it warms?", _warmth(surface, metadata)),
        ("What if two things touch it, or something long lies on it?", _several(metadata)),
        ("What if a sensor fails, or is knocked?", _failing(metadata)),
        ("What does a false contact mean?", _false(metadata)),
        ("Who calibrates it, and when?", _calibration(metadata)),
        (f"Is the {noun} strong enough?", _stress(surface, metadata)),
        ("How sure are these figures?", _figures(surface)),
        ("When do we accept it?", _acceptance(metadata, accepted_mm)),
    ]
    return [Question(question, " ".join(answer)) for question, answer in asked]


def _larger(metadata: Metadata) -> Iterator[str]:
    (weak, strong), over = metadata.ranges.force_n, overload_of(metadata)
    if not ForceRange(weak, strong).is_open:
        yield (
            f"A force that is not {_forces(metadata)} gives the state `unexplained` where the sensors show the "
            "difference. Elsewhere it moves the place, and no note says so: state a tolerance that the force keeps."
        )
    elif _states_force(metadata):
        yield f"Clearly beyond {strong:g} N, answers carry the note `overload`: do not act on them, take the load off."
    else:
        yield f"Beyond {strong:g} N no note says so, as this model states no force (`requirements.descriptors`)."
    if np.isfinite(over.leaves_range_n):
        yield (
            f"At {digits(over.leaves_range_n, 2)} N at the worst place, a sensor leaves its linear range, and takes no "
            "part in the answer."
        )
    if np.isfinite(over.touches_n):
        yield f"At {digits(over.touches_n, 2)} N, the {noun_of(metadata)} touches a sensor. {_stop(metadata)}"
    yield f"These forces lie on gently: a sudden one bends the {noun_of(metadata)} up to twice as far for a moment."


def _stop(metadata: Metadata) -> str:
    """Say where stops keep the beam off the sensors."""
    sensor = metadata.sensor
    sag_mm = metadata.ranges.force_n[1] * np.array(metadata.influence.mm_per_n).max(axis=0)
    closest = metadata.layout[int(sag_mm.argmax())]
    free, ends = digits(float(sag_mm.max()), 3), digits(sensor.standoff_mm - sensor.range_mm[0], 3)
    noun, place = noun_of(metadata), in_words(list(metadata.place_of(closest).values()))
    return (
        f"Put a stop under the {noun} beside each sensor, {free} to {ends} mm below the {noun} at rest: "
        f"{metadata.ranges.force_n[1]:g} N do not press it down that far, and it stops before that sensor leaves its "
        f"range. It comes closest at {closest.name}, {place} mm; a stop there does not protect the "
        "others."
    )


def _ends(metadata: Metadata, ends_mm: Sequence[float], middle_mm: float) -> Iterator[str]:
    first, last = (digits(mm, 2) for mm in ends_mm)
    if len(metadata.axes) > 1:
        yield (
            f"The mean error is {digits(middle_mm, 2)} mm in the middle, {first} mm along the rim and {last} mm in the "
            "corners."
        )
        ranges = " or ".join(
            f"{axis} = {low:g} to {high:g} mm"
            for axis, (low, high) in zip(metadata.axes, metadata.extent.ranges_mm, strict=True)
        )
        yield f"Outside {ranges} its answers mean nothing."
        return
    low, high = metadata.ranges.position_mm
    yield (
        f"The mean error is {digits(middle_mm, 2)} mm in the middle third, {first} mm at the left end of the range and "
        f"{last} mm at the right one."
    )
    yield f"Outside {low:g} to {high:g} mm its answers mean nothing."


def _ringing(surface: Surface, noun: str) -> Iterator[str]:
    found = surface.ringing
    if found is None:
        yield f"Nobody knows: the scene does not state the mass of the {noun}."
        return
    assumed = ", if its damping is as assumed" if found.damping_is_assumed else ""
    yield (
        f"After a sudden touch it rings for up to {digits(found.after_touch_s, 2)} s, after a lift for up to "
        f"{digits(found.after_lift_s, 2)} s{assumed}."
    )
    yield "Answers come all the same, with the note `unsteady` and an interval that is as wide as it must be."
    yield "A shaking frame looks like ringing: mount the supports on something that stands still."


def _warmth(surface: Surface, metadata: Metadata) -> Iterator[str]:
    walk, noun = walk_of(metadata, surface.readings), noun_of(metadata)
    if walk is None:
        yield "It is taken not to matter: the zeros of the sensors do not drift."
    else:
        rate, most = (typeset(size, metadata.unit, 2) for size in (walk.rate_mm_per_min, walk.max_mm))
        yield (
            f"Zeros that drift by {rate} a minute are followed whenever nothing touches the {noun}, until they are "
            f"{most} from the last tare; then the note "
            "`zeros` asks for another. Drift in one direction takes at least "
            f"{digits(walk.max_mm / walk.rate_mm_per_min, 2)} minutes to get there."
        )
        yield "While a contact lasts, its interval widens."
    expansion = next((effect for effect in surface.effects if effect.name == "expansion"), None)
    if expansion is not None and expansion.verdict != "out":
        yield f"The {noun} cannot lengthen freely: {expansion.reason}."
    yield f"Keep heat from one side away: a {noun} that is warmer above than below bows."


def _several(metadata: Metadata) -> Iterator[str]:
    yield (
        "What it notices gets the state `unexplained` and no place: two contacts far apart more often than two close "
        "together, which look like one between them. A load that is spread mostly looks like a contact in its middle."
    )
    if len(metadata.layout) < fewest_that_check(len(metadata.axes)):
        sees = "nothing notices it" if ForceRange(*metadata.ranges.force_n).is_open else "little notices it"
        yield f"With {len(metadata.layout)} sensors {sees}: each contact carries the note `unchecked`."
    else:
        yield "`design-sensors challenge` measures how often this surface notices what."


def _failing(metadata: Metadata) -> Iterator[str]:
    few, count = metadata.min_channels, len(metadata.layout)
    if few < count:
        yield f"Answers go on while {few} of {count} sensors work, marked `degraded`; the table above has their errors."
        yield "With fewer, there is no answer; never an old one."
    else:
        yield "Every sensor must work: without one there is no answer, and never an old one."
    checking = fewest_that_check(len(metadata.axes))
    if count > checking:
        yield "A sensor that contradicts the others makes contacts `unexplained`, and is named."
    elif count == checking:
        yield "A sensor that contradicts the others makes contacts `unexplained`; which one it is, so few do not show."
    else:
        yield f"A sensor that is knocked shows when nothing touches the {noun_of(metadata)}: look at it, and tare."


def _false(metadata: Metadata) -> Iterator[str]:
    often = per_day(metadata.thresholds.false_contacts_per_day)
    yield (
        f"While nothing touches the {noun_of(metadata)}, the noise of the sensors alone looks like a touch: {often}, "
        "on average."
    )
    yield "A hand, a tool or a cable that touches it counts as a contact, and rightly so."
    yield "`requirements.false_contacts_per_day` asks for fewer; the smallest force that is seen is larger then."


def _calibration(metadata: Metadata) -> Iterator[str]:
    gain, zero_mm = max(metadata.floor.gain), max(metadata.floor.zero_mm)
    yield (
        "You do, once it is mounted: tare it, and put about ten known weights at known places "
        "(`design-sensors calibrate`)."
    )
    yield (
        f"The figures hold if that leaves gains to ± {digits(100 * gain, 2)} % and zeros to ± "
        f"{typeset(zero_mm, metadata.unit, 2)}, as standard deviations."
    )
    yield f"Calibrate again after a sensor, a support or the {noun_of(metadata)} has been changed; tare after a knock."


def _stress(surface: Surface, metadata: Metadata) -> Iterator[str]:
    if surface.scene.plate is not None:
        yield (
            f"It moves by up to {digits(surface.travel.largest_mm, 3)} mm and slopes by up to "
            f"{digits(surface.travel.slope, 2)} rad. Its stress depends on how wide the contact is: that, sudden "
            "forces, which count twice, fatigue, holes and fastening are yours to check."
        )
        return
    if not surface.scene.has_beam:
        yield "Its influence was measured, not computed, so its stress is not known: that is yours to check."
        return
    strong, fall_mm, beam = metadata.ranges.force_n[1], surface.travel.largest_mm, surface.scene.beam
    stress_mpa = largest_stress_mpa(beam, strong, metadata.ranges.position_mm)
    if stress_mpa is None:
        yield "The scene does not state its thickness, so its stress is not computed."
    else:
        yield f"Under {strong:g} N at the worst place, bending stresses it by up to {digits(stress_mpa, 2)} MPa."
        material = None if beam.material is None else MATERIALS[beam.material]
        if material is not None and material.strength_mpa is not None:
            yield f"A weak grade of {beam.material} bears {material.strength_mpa:g} MPa once ({material.grade})."
        else:
            yield "Compare that with what its grade bears."
    yield (
        f"It bends by up to {digits(fall_mm, 3)} mm and slopes by up to {digits(surface.travel.slope, 2)} rad. Sudden "
        "forces, which count twice, fatigue, holes and fastening are yours to check."
    )


def _figures(surface: Surface) -> Iterator[str]:
    if not surface.scene.is_computed:
        yield (
            "They are simulated, for a structure that shows what its table of measured loads says, with every place "
            "and force of the ranges equally likely. ± is a standard error of the simulation."
        )
        return
    noun = "beam" if surface.scene.has_beam else "plate"
    yield (
        f"They are simulated, for a {noun}, sensors and loads exactly as stated here, with every place and force of "
        f"the ranges equally likely. Nothing was measured on your {noun}. ± is a standard error of the simulation."
    )


def _acceptance(metadata: Metadata, accepted_mm: float) -> Iterator[str]:
    error_mm = metadata.accuracy.error_percent / 100 * metadata.diagonal_mm
    yield (
        f"Draw {TRIED} places and forces of these ranges at random, before you see an answer, and press when the "
        f"{noun_of(metadata)} lies still. Accept if the mean error is at most {at_least(accepted_mm):g} mm "
        f"(about {digits(error_mm, 2)} mm are expected)"
    )
    if names_of(metadata.axes[0], "mm")[1] in metadata.golden.answers:
        each = "" if len(metadata.axes) == 1 else " along each axis"
        yield f"and at least {MUST_HOLD} of the {TRIED} places lie in their intervals{each}."
        trials = 60 // len(metadata.axes)
        yield f"A surface as stated here fails the first in one of 20 trials, and the second in one of {trials}."
    else:
        yield "over all of them. A surface as stated here fails that in one of 20 trials."
