"""The pace of contacts to the broker: the surfaces that are due, and when to look again. Pure: no clock."""

from collections.abc import Iterable
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
class _Sent:
    """The last message about a surface."""

    status: State | Kind
    newest: Newest | None
    at_s: float


class Pace:
    """Decides when the contact of each surface is due.

    It is due at once if its state, or the kind of its problem, is another one. A new sample in the same state is due at
    the next turn; turns are common to all surfaces. Everything else is due after `ALIVE_S`.
    """

    def __init__(self, surfaces: Iterable[Surface], max_rate_hz: float) -> None:
        self._surfaces = list(surfaces)
        self._turn_s = 1 / max_rate_hz
        self._next_turn_s = float("-inf")
        self._sent: dict[str, _Sent] = {}

    def has_news(self, surface: Surface, now_s: float) -> bool:
        """Return whether a surface with a new sample is due at once."""
        return now_s >= self._next_turn_s or self._has_changed(surface, now_s)

    def due(self, now_s: float) -> list[Surface]:
        """Return the surfaces that are due at `now_s` [s]."""
        return [surface for surface in self._surfaces if self._is_due(surface, now_s)]

    def sent(self, surfaces: Iterable[Surface], now_s: float) -> None:
        """Note that these surfaces are about to be told at `now_s` [s]."""
        for surface in surfaces:
            self._sent[surface.name] = _Sent(surface.view(now_s).status, surface.newest, now_s)
        if now_s >= self._next_turn_s:
            in_step_s = self._next_turn_s + self._turn_s
            self._next_turn_s = in_step_s if in_step_s > now_s else now_s + self._turn_s

    def wait_s(self, now_s: float) -> float:
        """Return the time until a surface may be due [s], if no sample changes a state before."""
        looks_s = [self._look_s(surface, now_s) for surface in self._surfaces]
        return max(0.0, min(looks_s, default=now_s + ALIVE_S) - now_s)

    def _has_changed(self, surface: Surface, now_s: float) -> bool:
        sent = self._sent.get(surface.name)
        return sent is None or surface.view(now_s).status is not sent.status

    def _is_due(self, surface: Surface, now_s: float) -> bool:
        sent = self._sent.get(surface.name)
        if sent is None or self._has_changed(surface, now_s) or now_s - sent.at_s >= ALIVE_S:
            return True
        has_moved = isinstance(sent.status, State) and surface.newest is not sent.newest
        return has_moved and now_s >= self._next_turn_s

    def _look_s(self, surface: Surface, now_s: float) -> float:
        """Return when to look at a surface."""
        sent = self._sent.get(surface.name)
        if sent is None:
            return now_s
        look_s = sent.at_s + ALIVE_S
        if not isinstance(sent.status, State) or surface.newest is None:
            return look_s
        stale_s = surface.newest.acquired_s + surface.stale_ms / 1e3 + _AFTER_LIMIT_S
        # A sample before the next turn is due at the turn. A sample after it is news.
        return min(look_s, stale_s, self._next_turn_s if self._next_turn_s > now_s else look_s)
