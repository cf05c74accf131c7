"""Remarks, one line each: on a scene that can be built, and on what a model misses or what one failed sensor costs."""

from collections.abc import Iterator

import numpy as np

from beamtouch_common.digits import digits
from beamtouch_common.units import fine
from beamtouch_models.design.building.table_remarks import remarks_on_table
from beamtouch_models.design.placement.placing import ALWAYS
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.materials import MATERIALS
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.filters import Walk
from beamtouch_models.numbers import at_least
from beamtouch_models.runtime.metadata import Metadata

TOO_MUCH = 2.0
"""Ratio of the error with one sensor failed to that with all from which a build warns."""
SINK = 0.45
"""Largest sink of a corner on its spring that is advised, over the length of the sensors' range."""
GIVES_WAY = 10.0
"""Stiffness of springs, over that of the softest that are advised, above which a plate hardly moves on them."""
KNOWN = 2.0
"""Ratio of the largest to the smallest force below which the force is hardly an unknown."""
SHORT_S = 60.0
"""Time in which a drift comes to the end of what the daemon follows, from which on a build does not warn."""


def remarks(scene: Scene) -> list[str]:
    """Return what an engineer should look at again in a scene."""
    if scene.plate is not None:
        return [*_assumed(scene.plate), *_hard(scene, scene.plate), *_too_few(scene)]
    if scene.measured is not None:
        return [*remarks_on_table(scene.measured, scene.contact), *_too_few(scene)]
    return [*_implausible(scene.beam), *_assumed(scene.beam)] if scene.has_beam else []


def _hard(scene: Scene, plate: Plate) -> Iterator[str]:
    """Yield a remark on supports that make places on a plate hard to tell; plates.md of docs/how-to has the figures."""
    low_mm, high_mm = scene.sensors.range_mm
    softest = at_least(scene.contact.force_range_n[1] / (SINK * (high_mm - low_mm)))
    stiffness = [support.stiffness_n_per_mm or np.inf for support in plate.support_list]
    if max(stiffness) <= GIVES_WAY * softest:
        return
    springs = f'supports = "corners" with support_stiffness_n_per_mm = {softest:g}'
    better = f"on springs at its corners a plate errs far less: try {springs}"
    if any(support.is_line for support in plate.support_list):
        yield f"{_in_words(plate)} is held along lines: hardly any place is told from another there; {better}"
    else:
        stands = (
            "rigid supports" if np.isinf(max(stiffness)) else f"springs of {max(stiffness):g} N/mm, as on rigid ones"
        )
        yield (
            f"{_in_words(plate)} stands on {stands}: places are told by small ratios of deflections, worst "
            f"near the supports; {better}"
        )


def _too_few(scene: Scene) -> Iterator[str]:
    """Yield a remark on fewer sensors than a contact on two axes has unknowns."""
    if len(scene.contact.ranges_mm) == 1:
        return
    weak, strong = scene.contact.force_range_n
    unknowns, least = ("x and y", 2) if strong < KNOWN * weak else ("x, y and force", 3)
    if (most := scene.count_range[1]) < least:
        few = "one sensor does" if most == 1 else f"{most} sensors do"
        yield f"{few} not tell {unknowns} of a contact; use {least} or more, and 4 to notice other loads"


def _in_words(plate: Plate) -> str:
    """Return what a plate is in words."""
    x_mm, y_mm = plate.size_mm
    return f"the plate of {x_mm:g} x {y_mm:g} x {plate.thickness_mm:g} mm"


def _implausible(beam: Beam) -> Iterator[str]:
    """Yield a remark on a modulus or a rigidity that no piece of the stated material has."""
    if beam.material is None:
        return
    low, high = MATERIALS[beam.material].modulus_range_gpa
    statement = f"beam.youngs_modulus_gpa = {beam.youngs_modulus_gpa or 0:g}"
    modulus_gpa = beam.youngs_modulus_gpa
    if modulus_gpa is None and beam.flexural_rigidity_n_mm2 is not None and beam.width_mm and beam.thickness_mm:
        modulus_gpa = 12e-3 * beam.flexural_rigidity_n_mm2 / beam.width_mm / beam.thickness_mm**3
        rigidity = f"beam.flexural_rigidity_n_mm2 = {beam.flexural_rigidity_n_mm2:g}"
        statement = f"{rigidity} means {digits(modulus_gpa, 3)} GPa, which"
    if modulus_gpa is not None and not low <= modulus_gpa <= high:
        yield f"{statement} is implausible for {beam.material}, which has {low:g} to {high:g} GPa; check it"


def _assumed(beam: Beam | Plate) -> Iterator[str]:
    """Yield a remark on a modulus that comes from the table, and scatters by more than a tenth."""
    if beam.material is None or beam.youngs_modulus_gpa is not None or beam.modulus_gpa is None:
        return
    low, high = MATERIALS[beam.material].modulus_range_gpa
    if low < 0.9 * beam.modulus_gpa or high > 1.1 * beam.modulus_gpa:
        yield (
            f"{beam.material} is taken with {beam.modulus_gpa:g} GPa; real pieces have {low:g} to {high:g}, and forces "
            "are wrong by as much: calibrate, or state youngs_modulus_gpa"
        )


def missed_requirement(metadata: Metadata, scene: Scene) -> str:
    """Say by how much a model misses the position error that its scene requires; empty if it does not."""
    return missed_error("mean error", metadata.accuracy.error_percent, scene)


def missed_error(name: str, percent: float, scene: Scene) -> str:
    """Say by how much an error in percent of the length exceeds what a scene requires; empty if it does not."""
    wanted_mm, error_mm = scene.requirements.position_error_mm, percent / 100 * scene.diagonal_mm
    if wanted_mm is None or error_mm <= wanted_mm:
        return ""
    return (
        f"the {name} is {digits(error_mm, 3)} mm, more than requirements.position_error_mm = {wanted_mm:g}; use more "
        "sensors or less noise, or allow more latency_ms"
    )


def weak_spot(metadata: Metadata, scene: Scene) -> str:
    """Say whether one failed sensor ends a surface or doubles its error; empty if neither."""
    layout, placed, limit_percent = metadata.layout, metadata.placed, metadata.accuracy.limit_percent
    remedy, can_move = _further_sensor(len(layout), scene)
    if metadata.min_channels == len(layout) == 1:
        return f"one failed sensor ends this surface: it has no other; {remedy}"
    if can_move and placed.failed_percent != ALWAYS:
        remedy += ", or place them with --failed-percent 100"
    if metadata.min_channels == len(layout):
        return f"one failed sensor ends this surface: all {len(layout)} channels must work; {remedy}"
    worst = max(placed.limit_without_percent)
    if worst < TOO_MUCH * limit_percent:
        return ""
    name = layout[placed.limit_without_percent.index(worst)].name
    with_all, without = (digits(percent / 100 * metadata.diagonal_mm, 3) for percent in (limit_percent, worst))
    return f"if {name} fails, the mean position error grows from {with_all} to {without} mm; {remedy}"


def _further_sensor(sensors: int, scene: Scene) -> tuple[str, bool]:
    """Say how a layout gets one more sensor; returns whether its sensors could also stand elsewhere."""
    if scene.measured is None:
        return "add a sensor", True
    if len(scene.measured.loads.names) > sensors:
        return "use more of the sensors that were measured", True
    return "measure a further sensor under all loads", False


def short_tare(walk: Walk | None, unit: str) -> str:
    """Say in which time the drift of zeros comes to the end of what the daemon follows; empty if it takes long."""
    if walk is None or (lasts_s := 60 * walk.max_mm / walk.rate_mm_per_min) >= SHORT_S:
        return ""
    rate, most = fine(walk.rate_mm_per_min, unit, 2), fine(walk.max_mm, unit, 2)
    return (
        f"zeros that drift by {rate} a minute are followed for {digits(lasts_s, 2)} s after a tare only, over "
        f"{most}, and light contacts are taken for drift then; use sensors that drift less and state "
        "environment.drift_um_per_min, or begin contact.force_n at a larger force"
    )
