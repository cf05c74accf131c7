"""Access control: named bearer tokens and the requests that each allows. Pure: no web framework, no clock, no I/O."""

import hmac
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Self

from beamtouch_service.problems import Kind, Problem, ProblemError

_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="beamtouch"'}
Tokens = Mapping[str, str]
"""Name -> token."""


class Role(Enum):
    """The right that a request needs: a kind of token, and the option with its file. Each includes those before."""

    OPEN = ("", "")
    READ = ("read", "--read-token-file")
    WRITE = ("write", "--write-token-file")
    ADMIN = ("admin", "--admin-token-file")

    def __init__(self, token: str, option: str) -> None:
        self.token = token
        self.option = option

    def includes(self, other: "Role") -> bool:
        """Return whether who may do this may also do the other."""
        order = list(Role)
        return order.index(self) >= order.index(other)


_DISABLED = {
    Role.WRITE: "Writes are disabled. To enable them, start the service with --write-token-file FILE.",
    Role.ADMIN: (
        "Administration is disabled. To enable it, start the service with --write-token-file FILE or "
        "--admin-token-file FILE."
    ),
}


@dataclass(frozen=True)
class Access:
    """The tokens of a service for each role."""

    write: Tokens = field(default_factory=dict, repr=False)
    read: Tokens = field(default_factory=dict, repr=False)
    """Empty: reads need no token."""
    admin: Tokens = field(default_factory=dict, repr=False)
    """Empty: the write tokens also administrate."""

    @classmethod
    def of(cls, write: str | None = None, read: str | None = None, admin: str | None = None) -> Self:
        """Return the access with at most one token for each role, named after it."""
        given = (("write", write), ("read", read), ("admin", admin))
        return cls(**{name: {name: token} for name, token in given if token is not None})

    def sufficient(self, role: Role) -> list[Role]:
        """Return the kinds of tokens with which a request for `role` passes, the least first."""
        least = Role.WRITE if role is Role.ADMIN and not self.admin else role
        return [one for one in Role if one.includes(least)]

    def require(self, role: Role, authorization: bytes | None) -> str:
        """Let a request pass whose `Authorization` header has a token for `role`; return its name, or "" without need.

        Raises
        ------
        ProblemError
            401 without a valid token, or if the role is disabled; 403 with a token for another role.
        """
        if role is Role.OPEN or (role is Role.READ and not self.read):
            return ""
        sufficient = self.sufficient(role)
        if role is not Role.READ and not any(self._of(one) for one in sufficient):
            raise _unauthorized(_DISABLED[role])
        held, name = self._find(authorization or b"")
        if held in sufficient:
            return name
        needed = next(one for one in sufficient if self._of(one))
        detail = f"This is the {held.token} token. Use the {needed.token} token ({needed.option})."
        raise ProblemError(Problem(Kind.FORBIDDEN, detail))

    def _of(self, role: Role) -> Tokens:
        return {Role.READ: self.read, Role.WRITE: self.write, Role.ADMIN: self.admin}.get(role, {})

    def _find(self, authorization: bytes) -> tuple[Role, str]:
        scheme, _, given = authorization.partition(b" ")
        if scheme.lower() != b"bearer":
            raise _unauthorized("Send the header `Authorization: Bearer TOKEN` with a token of the service.")
        # Compares with every token, so that the time it takes tells nothing about them.
        held = [
            (role, name)
            for role in Role
            for name, token in self._of(role).items()
            if hmac.compare_digest(given.strip(), token.encode())
        ]
        if not held:
            raise _unauthorized("This is not a token of the service. Check its token files.")
        return held[0]


def _unauthorized(detail: str) -> ProblemError:
    return ProblemError(Problem(Kind.UNAUTHORIZED, detail), _CHALLENGE)
