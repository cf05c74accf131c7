"""A layout beside others: the paper's, equal pitch, and the one that counts on all sensors, with what each costs."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from beamtouch_common.digits import digits
from beamtouch_models.arrays import Floats
from beamtouch_models.design.effort import LEAST, Effort
from beamtouch_models.design.layout import Layout
from beamtouch_models.design.placement.layout_rules import equal_pitch_mm
from beamtouch_models.design.placement.placing import Aim, place, place_by_position_error
from beamtouch_models.design.placement.reasons import Costs, costs_of, reasons_for
from beamtouch_models.errors import SceneError
from beamtouch_models.names import CRITERIA
from beamtouch_models.places import as_stated, in_rows, in_words

LOOKED_FOR = 0.25
"""Effort of a search for a layout that is only compared, over that of the layout."""
WORTH = 0.03
"""Share of the error by which another layout must err less to be worth a line."""
TAKEN, PAPERS, EQUAL = "this layout", "the paper's", "equal pitch"
ANEW, ALL_WORK = "placed anew", "if no sensor failed"


@dataclass(frozen=True)
class Compared:
    """Layouts with the same number of sensors, by name, and what each costs on the same contacts."""

    positions_mm: dict[str, Floats]
    """(sensors,) each; on a plate (sensors, 2)."""
    costs: dict[str, Costs]
    reasons: Sequence[str]
    """A sentence a sensor of the layout taken."""

    @property
    def offer(self) -> str:
        """Say which layout errs clearly less while all sensors work, and what it would cost; empty if none does."""
        if ALL_WORK not in self.costs:
            return ""
        taken, other = self.costs[TAKEN], self.costs[ALL_WORK]
        saved = 1 - other.all_mm / taken.all_mm
        if saved < WORTH or not taken.failed_mm:
            return ""
        places = ", ".join(map(in_words, self.positions_mm[ALL_WORK]))
        worst, worst_taken = (f"{digits(max(costs.failed_mm), 3)} mm" for costs in (other, taken))
        return (
            f"{places} mm would err {digits(100 * saved, 2)} % less, {digits(other.all_mm, 3)} mm, while all sensors "
            f"work, and {worst} instead of {worst_taken} with the worst one failed: --failed-percent 0"
        )


def compare_layout(layout: Layout, seed: int, *, anew: bool = False) -> Compared:
    """Return a layout beside others, found and compared with its effort; the same seed gives the same.

    `anew` asks also for the default layout of the scene.
    """
    surface, aim, taken = layout.surface, layout.aim, layout.positions_mm
    influence, rules, count = surface.influence, surface.rules, len(taken)
    effort = Effort(max(LEAST, LOOKED_FOR * aim.effort.share))
    positions = {TAKEN: taken}
    # The rules may leave too few independent readings; only the product needs as many as there are sensors.
    with suppress(SceneError):
        positions[PAPERS] = as_stated(place(influence, rules, count, seed, effort=aim.effort).place_mm)
    if surface.scene.measured is None:  # elsewhere, nobody has measured a sensor
        positions[EQUAL] = as_stated(equal_pitch_mm(influence.size_mm, count))
    shares = {ANEW: surface.scene.requirements.failed_percent} if anew else {}
    if aim.failed_percent:
        shares[ALL_WORK] = 0.0
    for name, percent in shares.items():
        other = Aim(CRITERIA[0], percent, effort=effort)
        # One sensor is not placed for its own failure.
        with suppress(SceneError):
            found = place_by_position_error(influence, rules, count, seed, surface.sampling, other)
            positions[name] = as_stated(found.place_mm)
    places = [in_rows(each, influence.extent.axes) for each in positions.values()]
    costs = dict(zip(positions, costs_of(influence, surface.errors, places, seed + 1, aim.effort), strict=True))
    # Sensors that were measured stand where they stand: none is side by side with another to keep a rule.
    gap_mm = rules.gap_mm if surface.scene.measured is None else 0.0
    is_fixed = (places[0][:, None] == rules.place_mm[rules.fixed]).all(axis=2).any(axis=1)
    reasons = reasons_for(costs[TAKEN], gap_mm, is_fixed)
    return Compared(positions, costs, reasons)
