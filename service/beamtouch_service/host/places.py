"""Decides which connections stay open when there are too many. Pure: no sockets, no clock.

A connection that has shown a token outranks one that has not. Among those without a token, the ones that wait for their
client close first: those without a request yet, then those with an unread answer, then idle ones. Within each of these
kinds, the address with the most connections gives one up; among equal addresses, the longest idle connection closes.

A client that has just connected has had no time for a request. So the connections without one of an address are spared
at first while they are few, a quarter of what it may have: otherwise a crowd of idle clients would keep out whoever
comes.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any, Generic, TypeVar

Who = TypeVar("Who")


class State(Enum):
    """The event that a connection waits for, unless it is busy."""

    SILENT = auto()
    """The first request."""
    IDLE = auto()
    """The next request."""
    UNREAD = auto()
    """The client to read an answer."""


@dataclass(slots=True)
class _Held:
    address: str
    state: State
    has_token: bool
    kind: dict[str, dict[Any, None]]
    """All connections of the same state that have, or have not, shown a token, by address."""
    beside: dict[Any, None] = field(default_factory=dict)
    """Those of the same address, including this one."""


MAX_WAITING = 32
"""Excess clients that get a 503 or may still show a token. Any further ones are disconnected."""


class Places(Generic[Who]):
    """The connections of one service.

    Parameters
    ----------
    max_clients : open connections
    max_per_address : open connections of one address without a token
    is_busy : returns whether a connection waits for the service: a request is being answered, or was not read yet
    """

    def __init__(self, max_clients: int, max_per_address: int, is_busy: Callable[[Who], bool]) -> None:
        self._max_clients = max_clients
        self._max_per_address = max_per_address
        self._spared = max_per_address // 4
        """Silent connections of one address that leave last."""
        self._is_busy = is_busy
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
        self._put(who, address, State.SILENT, has_token=has_token)
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
        """Note what a connection waits for from now on, and whether it has shown a token, which it keeps."""
        held = self._held.get(who)
        if held is None:
            return
        if held.state is state and (held.has_token or not has_token):
            # The usual case: only its idle time restarts.
            del held.beside[who]
            held.beside[who] = None
            held.kind[held.address] = held.kind.pop(held.address)
        else:
            self._pull(who)
            self._put(who, held.address, state, has_token=held.has_token or has_token)

    def _put(self, who: Who, address: str, state: State, *, has_token: bool) -> None:
        kind = self._kinds[state, has_token]
        self._held[who] = held = _Held(address, state, has_token, kind, kind.pop(address, {}))
        kind[address] = held.beside
        held.beside[who] = None
        if not has_token:
            self._without_token[address] += 1

    def _pull(self, who: Who) -> None:
        held = self._held.pop(who)
        del held.beside[who]
        if not held.beside:
            del held.kind[held.address]
        if not held.has_token:
            self._without_token[held.address] -= 1
            if not self._without_token[held.address]:
                del self._without_token[held.address]

    def _victim(self, *, has_token: bool, address: str | None = None) -> Who | None:
        for state, spared in ((State.SILENT, self._spared), (State.UNREAD, 0), (State.IDLE, 0), (State.SILENT, 0)):
            for who in self._without(state, address, spared):
                if state is State.UNREAD or not self._is_busy(who):
                    return who
        if not has_token:
            return None
        # These leave only for a connection with a token: busy ones without, then idle ones with a token.
        busy = (who for state in State for who in self._without(state))
        largest_first = sorted(self._kinds[State.IDLE, True].values(), key=len, reverse=True)
        idle = (who for beside in largest_first for who in beside if not self._is_busy(who))
        return next(busy, None) or next(idle, None)

    def _without(self, state: State, address: str | None = None, spared: int = 0) -> Iterator[Who]:
        """Give the connections without a token in this state, of one address or of all, in the order to leave.

        Addresses with at most `spared` of them are left out.
        """
        by_address = self._kinds[state, False]
        order = [address] if address else sorted(by_address, key=self._without_token.__getitem__, reverse=True)
        return (who for one in order if len(by_address.get(one, ())) > spared for who in by_address[one])
