"""Who holds the connections that a service may have, and who gives one up for a newcomer. Pure: no sockets, no clock.

A connection that has borne a token comes before one that has not. Among those without, the ones that wait for their own
client go first, and of these the ones of the address that holds most, the longest idle first.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any, Generic, TypeVar

Who = TypeVar("Who")


class State(Enum):
    """What a connection waits for."""

    SILENT = auto()
    """Its first request; a head that is not complete is none."""
    IDLE = auto()
    """The next request."""
    UNREAD = auto()
    """A client that does not read the answer."""
    BUSY = auto()
    """The service."""


@dataclass
class _Held:
    address: str
    state: State
    has_token: bool
    beside: dict[Any, None] = field(default_factory=dict)
    """The connections of the same kind and address, this one among them."""


MAX_WAITING = 32
"""Connections without a place that may still say that they have a token, or be told that there is no place."""
_FOR_EVERYONE = ((State.SILENT, False), (State.IDLE, False), (State.UNREAD, False))
_FOR_TOKENS = (*_FOR_EVERYONE, (State.BUSY, False), (State.IDLE, True))


class Places(Generic[Who]):
    """The connections of one service.

    Parameters
    ----------
    most : connections at a time
    most_per_address : without a token, of one address
    has_spoken : whether a connection has sent something that was not read yet, and is therefore not idle
    """

    def __init__(self, most: int, most_per_address: int, has_spoken: Callable[[Who], bool]) -> None:
        self._most = most
        self._most_per_address = most_per_address
        self._has_spoken = has_spoken
        self._held: dict[Who, _Held] = {}
        self._waiting: dict[Who, None] = {}
        # Of each kind the connections by address, in the order in which they came to be of that kind.
        self._kinds: dict[tuple[State, bool], dict[str, dict[Who, None]]] = {
            (state, has_token): {} for state in State for has_token in (False, True)
        }

    def take(self, who: Who, address: str, *, has_token: bool = False) -> tuple[bool, Who | None]:
        """Give a place to a newcomer; return whether there is one, and who has to leave for it."""
        victim = None
        if not has_token and self._without_token(address) >= self._most_per_address:
            victim = self._victim(has_token=False, address=address)
            if victim is None:
                return False, None
        elif len(self._held) >= self._most:
            victim = self._victim(has_token=has_token)
            if victim is None:
                return False, None
        if victim is not None:
            self.leave(victim)
        self._waiting.pop(who, None)
        self._put(who, _Held(address, State.SILENT, has_token))
        return True, victim

    def wait(self, who: Who) -> Who | None:
        """Note a newcomer without a place; return who has to leave because too many wait, the first of them."""
        self._waiting[who] = None
        return next(iter(self._waiting)) if len(self._waiting) > MAX_WAITING else None

    def leave(self, who: Who) -> None:
        """Give a place back, if there is one."""
        self._waiting.pop(who, None)
        if who in self._held:
            self._pull(who)

    def move(self, who: Who, state: State, *, has_token: bool = False) -> None:
        """Note what a connection waits for from now on, and whether it has borne a token; it keeps that."""
        held = self._held.get(who)
        if held is None:
            return
        if held.state is state and (held.has_token or not has_token):
            # As most often: only that it was idle for no time now.
            del held.beside[who]
            held.beside[who] = None
        else:
            self._pull(who)
            self._put(who, _Held(held.address, state, held.has_token or has_token))

    def _put(self, who: Who, held: _Held) -> None:
        self._held[who] = held
        held.beside = self._kinds[held.state, held.has_token].setdefault(held.address, {})
        held.beside[who] = None

    def _pull(self, who: Who) -> _Held:
        held = self._held.pop(who)
        by_address = self._kinds[held.state, held.has_token]
        del by_address[held.address][who]
        if not by_address[held.address]:
            del by_address[held.address]
        return held

    def _without_token(self, address: str) -> int:
        return sum(len(self._kinds[state, False].get(address, ())) for state in State)

    def _victim(self, *, has_token: bool, address: str | None = None) -> Who | None:
        for kind in _FOR_TOKENS if has_token else _FOR_EVERYONE:
            by_address = self._kinds[kind]
            # The address that holds most comes first.
            order = sorted(by_address, key=self._without_token, reverse=True) if address is None else [address]
            for one in order:
                for who in by_address.get(one, ()):
                    if kind[0] in (State.UNREAD, State.BUSY) or not self._has_spoken(who):
                        return who
        return None
