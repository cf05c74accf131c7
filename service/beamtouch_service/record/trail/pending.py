"""Changes that are yet to be put on record. Pure: no database, no clock."""

import math
from collections.abc import Callable

from beamtouch_service.record.trail.entry import Action, Entry, encode_details

MOST_DUE = 1000
"""Entries that wait while the record is away. Further ones are counted."""
MOST_STATES = 5000
"""States of each action that are watched. Whoever has a token could state any number of addresses, which must not keep
the models and tares of surfaces from being told."""
REST_S = 60.0
"""A state that changes more often than this is noted as it is then: two daemons that send in turn would fill a disk."""
LOSS_REST_S = 3600.0
"""Time between two entries of losses. Beyond `MOST_STATES`, each request loses one, and the trail is kept for good."""


class PendingTrail:
    """Entries in memory, until a commit has put them on record."""

    def __init__(self) -> None:
        self.due: list[Entry] = []
        self._states: dict[Action, dict[tuple[str, str], tuple[object, float]]] = {}
        """Action -> surface and subject -> value, and when it changed [s, monotonic]; minus infinity before it did."""
        self._lost = 0
        self._lost_since_us = 0
        self._told_s = -math.inf
        """When losses were last told [s, monotonic]."""

    def note(self, entry: Entry) -> None:
        """Note an act."""
        if len(self.due) >= MOST_DUE:
            self._lose(entry.at_us)
        else:
            self.due.append(entry)

    def note_state(
        self, action: Action, surface: str, subject: str, value: object, now_s: float, make: Callable[[], Entry]
    ) -> None:
        """Note a state, if its value differs from the one that was noted last.

        It may be stated as often as it is known: the entry is made only when it is needed.
        """
        states, key = self._states.setdefault(action, {}), (surface, subject)
        noted = states.get(key)
        if noted and (noted[0] == value or now_s - noted[1] < REST_S):
            return
        entry = make()
        if noted is None and len(states) >= MOST_STATES:
            self._lose(entry.at_us)
        elif len(self.due) < MOST_DUE:  # else it is noted later
            states[key] = value, now_s if noted else -math.inf
            self.due.append(entry)

    def _lose(self, at_us: int) -> None:
        self._lost_since_us = self._lost_since_us if self._lost else at_us
        self._lost += 1

    def take_due(self, now_s: float) -> list[Entry]:
        """Return what is due, for a commit. If that fails, `put_back` has to follow."""
        due, self.due = self.due, []
        if self._lost and len(due) < MOST_DUE and now_s - self._told_s >= LOSS_REST_S:
            details = encode_details({"entries": self._lost, "since_us": self._lost_since_us})
            due.append(Entry(self._lost_since_us, Action.LOSS, details))
            self._lost, self._told_s = 0, now_s
        return due

    def put_back(self, due: list[Entry]) -> None:
        """Put back what could not be committed, before what came meanwhile."""
        self.due = due + self.due

    def forget_states(self, but: list[Entry]) -> None:
        """Note all states anew, but not those of some entries and of what is due: another record has these, or will."""
        kept = {entry.key for entry in (*but, *self.due)}
        self._states = {
            action: {key: noted for key, noted in states.items() if (action, *key) in kept}
            for action, states in self._states.items()
        }
