"""Decides which connections stay open when there are too many. Pure: no sockets, no clock.

A connection that has shown a token outranks one that has not. Among those without a token, the ones that wait for their
client close first: those without a request yet, then those with an unread answer, then idle ones. Within each of these
kinds, the address with the most connections gives one up; among equal addresses, the longest idle connection closes.

A client that has just connected has had no time for a request. So connections without one are spared at first as long
as they fill only a quarter of the places: otherwise a crowd of idle clients would keep out whoever comes.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any, Generic, TypeVar

Who = TypeVar("Who")


class State(Enum):
    """What a connection is waiting for."""

    SILENT = auto()
    """Its first complete request."""
    IDLE = auto()
    """The next request."""
    UNREAD = auto()
    """The client to read an answer."""
    BUSY = auto()
    """The service to answer."""


@dataclass
class _Held:
    address: str
    state: State
    has_token: bool
    beside: dict[Any, None] = field(default_factory=dict)
    """All connections of the same kind and address, including this one."""


MAX_WAITING = 32
"""Excess clients that get a 503 or may still show a token. Any further ones are disconnected."""
_SILENT_FIRST = ((State.SILENT, False), (State.UNREAD, False), (State.IDLE, False))
_SILENT_LAST = (*_SILENT_FIRST[1:], _SILENT_FIRST[0])
_FOR_TOKENS = ((State.BUSY, False), (State.IDLE, True))
"""These leave only for a connection with a token."""


class Places(Generic[Who]):
    """The connections of one service.

    Parameters
    ----------
    max_clients : open connections
    max_per_address : open connections of one address without a token
    has_spoken : returns whether a connection has sent bytes that were not read yet, so that it is not idle
    """

    def __init__(self, max_clients: int, max_per_address: int, has_spoken: Callable[[Who], bool]) -> None:
        self._max_clients = max_clients
        self._max_per_address = max_per_address
        self._has_spoken = has_spoken
        self._held: dict[Who, _Held] = {}
        self._waiting: dict[Who, None] = {}
        self._without_token: Counter[str] = Counter()
        """Address -> number of its connections that have not shown a token."""
        # For each kind, the connections by address. Addresses and their connections are ordered, longest idle first.
        self._kinds: dict[tuple[State, bool], dict[str, dict[Who, None]]] = {
            (state, has_token): {} for state in State for has_token in (False, True)
        }

    def take(self, who: Who, address: str, *, has_token: bool = False) -> tuple[bool, Who | None]:
        """Ask for a place. Return whether there is one, and the connection that has to leave for it."""
        victim = None
        if not has_token and self._without_token[address] >= self._max_per_address:
            victim = self._victim(has_token=False, address=address)
            if victim is None:
                return False, None
        elif len(self._held) >= self._max_clients:
            victim = self._victim(has_token=has_token)
            if victim is None:
                return False, None
        if victim is not None:
            self.leave(victim)
        self._waiting.pop(who, None)
        self._put(who, _Held(address, State.SILENT, has_token))
        return True, victim

    def wait(self, who: Who) -> Who | None:
        """Note a connection without a place. If too many wait, return the first of them, which has to leave."""
        self._waiting[who] = None
        return next(iter(self._waiting)) if len(self._waiting) > MAX_WAITING else None

    def leave(self, who: Who) -> None:
        """Give a place back."""
        self._waiting.pop(who, None)
        if who in self._held:
            self._pull(who)

    def move(self, who: Who, state: State, *, has_token: bool = False) -> None:
        """Note what a connection is waiting for now, and whether it has shown a token, which it keeps."""
        held = self._held.get(who)
        if held is None:
            return
        if held.state is state and (held.has_token or not has_token):
            # The usual case: only its idle time restarts.
            del held.beside[who]
            held.beside[who] = None
            by_address = self._kinds[held.state, held.has_token]
            by_address[held.address] = by_address.pop(held.address)
        else:
            self._pull(who)
            self._put(who, _Held(held.address, state, held.has_token or has_token))

    def _put(self, who: Who, held: _Held) -> None:
        self._held[who] = held
        by_address = self._kinds[held.state, held.has_token]
        held.beside = by_address[held.address] = by_address.pop(held.address, {})
        held.beside[who] = None
        if not held.has_token:
            self._without_token[held.address] += 1

    def _pull(self, who: Who) -> _Held:
        held = self._held.pop(who)
        by_address = self._kinds[held.state, held.has_token]
        del by_address[held.address][who]
        if not by_address[held.address]:
            del by_address[held.address]
        if not held.has_token:
            self._without_token[held.address] -= 1
            if not self._without_token[held.address]:
                del self._without_token[held.address]
        return held

    def _victim(self, *, has_token: bool, address: str | None = None) -> Who | None:
        without_token = _SILENT_FIRST if self._are_many_silent(address) else _SILENT_LAST
        for kind in without_token + (_FOR_TOKENS if has_token else ()):
            by_address = self._kinds[kind]
            # The address with the most connections comes first.
            holds = {one: len(with_token) for one, with_token in by_address.items()} if kind[1] else self._without_token
            order = sorted(by_address, key=holds.__getitem__, reverse=True) if address is None else [address]
            for one in order:
                for who in by_address.get(one, ()):
                    if kind[0] in (State.UNREAD, State.BUSY) or not self._has_spoken(who):
                        return who
        return None

    def _are_many_silent(self, address: str | None) -> bool:
        silent = self._kinds[State.SILENT, False]
        if address is not None:
            return len(silent.get(address, ())) > self._max_per_address // 4
        return sum(map(len, silent.values())) > self._max_clients // 4
