"""One attempt to prove that a unit on a bus owes no value: the choice of probes, and the conclusion from answers.

Probes are tried only on a unit that answers something, so a silent unit costs the bus one timeout per attempt.
"""

import secrets

from beamtouch_daemon.sources.rtu_unit import AT_A_START, EXPLORE_S, Probe, Unit, probes_of


class Proof:
    """One attempt to prove that a unit owes no value.

    Parameters
    ----------
    unit
        Unit to be proven.
    now_s
        Time on the monotonic clock.
    forgotten_s
        Largest delay of an answer. It matters only for a unit with fewer than two probes.
    """

    def __init__(self, unit: Unit, now_s: float, forgotten_s: float) -> None:
        is_safe = len(unit.works) >= AT_A_START
        if unit.probes_needed and now_s - max(unit.explored_s, unit.proven_s if is_safe else 0.0) > EXPLORE_S:
            unit.is_known = False  # the address may belong to another device by now
        if not unit.is_known:
            unit.require_probes(AT_A_START)
        if not unit.is_known or not is_safe:
            unit.forget(now_s - forgotten_s)
        self.lives = False
        """Whether the unit has answered anything."""
        self._unit = unit
        self._left = list(unit.works)
        self._may_repeat = unit.is_known and is_safe
        """Whether to repeat a probe while an answer to it is owed; the proof then needs another probe as well."""
        if not unit.is_known:
            unit.explored_s = now_s
            self._left += [probe for probe in probes_of(unit.asked) if probe not in unit.works]
            # Answers to probes of an earlier program may still come, but hardly in this order.
            secrets.SystemRandom().shuffle(self._left)
        self._tried: set[Probe] = set()
        self._answered: list[Probe] = []
        self._fresh = False

    @property
    def is_held_back(self) -> bool:
        """Whether nothing may be sent now, because an answer to every working probe is still owed."""
        unit = self._unit
        is_unsafe = unit.is_known and bool(unit.works) and not self._may_repeat
        return is_unsafe and all(map(unit.owes, unit.works))

    def next(self) -> Probe | None:
        """Return the probe to send now; None if the attempt is over."""
        unit = self._unit
        is_silent = not self.lives and (self._tried or not unit.is_known)
        if not unit.probes_needed or not self._left or is_silent:
            return None
        fresh = [probe for probe in self._left if not unit.owes(probe)]
        if fresh:
            chosen = fresh[0]
        elif not self._tried and self._may_repeat:
            chosen = unit.last_of(self._left)
        else:
            return None
        self._left.remove(chosen)
        self._tried.add(chosen)
        self._fresh = not unit.owes(chosen)
        return chosen

    def take(self, probe: Probe, *, lives: bool, answered: bool) -> None:
        """Add the result of a probe: whether anything came, and whether it was the answer to this probe."""
        self.lives |= lives
        if not answered:
            return
        self._unit.answered(probe, fresh=self._fresh)
        if self._fresh:
            self._unit.probes_needed -= 1
            self._answered.append(probe)
        else:
            self._left.append(probe)

    def end(self, now_s: float) -> None:
        """Decide which probes work, and whether enough of them were answered."""
        unit = self._unit
        if not unit.is_known and self.lives and not (unit.probes_needed and any(map(unit.owes, self._left))):
            unit.works, unit.is_known = tuple(self._answered), True
        if self._answered and (not unit.probes_needed or (unit.is_known and len(self._answered) == len(unit.works))):
            unit.is_in_step(now_s)
