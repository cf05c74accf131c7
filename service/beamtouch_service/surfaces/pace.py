"""The pace at which a listener is told about surfaces: those that are due, and when to look again. Pure: no clock."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from beamtouch_models.runtime import State
from beamtouch_service.problems import Kind
from beamtouch_service.surfaces.surface import Surface
from beamtouch_service.surfaces.view import Newest

ALIVE_S = 0.9
"""Without a new sample, a surface is due again after this time. Some delay is left to the second that is promised."""
_AFTER_LIMIT_S = 1e-3
"""A surface is stale when its age is beyond the limit, not at the limit."""


@dataclass(frozen=True)
class _Told:
    """The surface as the listener knows it."""

    status: State | Kind
    newest: Newest | None
    at_s: float


class Pace:
    """Decides when each surface is due.

    A new sample is due at the next turn; turns are common to all surfaces. Another status (a state, or the kind of a
    problem) is due at once, or also at the next turn. Everything is due again after `ALIVE_S`.
    """

    def __init__(self, surfaces: Iterable[Surface], turn_s: float, *, tells_status_at_once: bool = True) -> None:
        """Turns are at least `turn_s` apart [s]. Without `tells_status_at_once`, nothing is due between two turns."""
        self._surfaces = list(surfaces)
        self._turn_s, self._tells_status_at_once = turn_s, tells_status_at_once
        self._next_turn_s = float("-inf")
        self._told: dict[str, _Told] = {}

    def has_news(self, surface: Surface, now_s: float) -> bool:
        """Return whether a surface with a new sample is due at once."""
        return now_s >= self._next_turn_s or (self._tells_status_at_once and self._has_changed(surface, now_s))

    def due(self, now_s: float) -> list[Surface]:
        """Return the surfaces that are due at `now_s` [s]."""
        return [surface for surface in self._surfaces if self._is_due(surface, now_s)]

    def note_told(self, surfaces: Sequence[Surface], now_s: float) -> None:
        """Note that the listener is told about these surfaces at `now_s` [s]; if there are none, no turn is used."""
        if not surfaces:
            return
        for surface in surfaces:
            self._told[surface.name] = _Told(surface.view(now_s).status, surface.newest, now_s)
        if now_s >= self._next_turn_s:
            in_step_s = self._next_turn_s + self._turn_s
            self._next_turn_s = in_step_s if in_step_s > now_s else now_s + self._turn_s

    def wait_s(self, now_s: float) -> float:
        """Return the time until a surface may be due [s], if no sample changes a status before."""
        looks_s = [self._look_s(surface, now_s) for surface in self._surfaces]
        return max(0.0, min(looks_s, default=now_s + ALIVE_S) - now_s)

    def _has_changed(self, surface: Surface, now_s: float) -> bool:
        told = self._told.get(surface.name)
        return told is None or surface.view(now_s).status is not told.status

    def _is_due(self, surface: Surface, now_s: float) -> bool:
        told, is_turn = self._told.get(surface.name), now_s >= self._next_turn_s
        if told is None:
            return True
        if is_turn and surface.newest is not told.newest:
            return True
        if not (is_turn or self._tells_status_at_once):
            return False
        return now_s - told.at_s >= ALIVE_S or self._has_changed(surface, now_s)

    def _look_s(self, surface: Surface, now_s: float) -> float:
        """Return when to look at a surface."""
        told = self._told.get(surface.name)
        if told is None:
            return now_s
        looks_s = [told.at_s + ALIVE_S]
        if surface.newest:
            stale_s = surface.newest.acquired_s + surface.stale_ms / 1e3 + _AFTER_LIMIT_S
            # A state ends there for certain. A problem may stay as it is, and must not be looked at again and again.
            if stale_s > (told.at_s if isinstance(told.status, State) else now_s):
                looks_s.append(stale_s)
            if self._next_turn_s > now_s and surface.newest is not told.newest:
                looks_s.append(self._next_turn_s)
        look_s = min(looks_s)
        return look_s if self._tells_status_at_once else max(look_s, self._next_turn_s)
