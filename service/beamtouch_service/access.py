"""Who may do what: three bearer tokens, and the request that each opens. Pure: no web framework, no clock, no I/O."""

import hmac
from dataclasses import dataclass, field
from enum import Enum

from beamtouch_service.problems import Kind, Problem, ProblemError

_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="beamtouch"'}


class Role(Enum):
    """What a request needs, and the option that names the file of its token."""

    OPEN = ("nothing", "")
    READ = ("reading", "--read-token-file")
    WRITE = ("writing", "--token-file")
    ADMIN = ("administration", "--admin-token-file")

    def __init__(self, purpose: str, option: str) -> None:
        self.purpose = purpose
        self.option = option


_REFUSED_WITHOUT = {
    Role.WRITE: "Writes are not allowed: start the service with --token-file FILE to allow them.",
    Role.ADMIN: "Administration is not allowed: start the service with --admin-token-file FILE to allow it.",
}


@dataclass(frozen=True)
class Access:
    """The tokens of a service, None where there is none; each that can write or administrate can also read."""

    write: str | None = field(default=None, repr=False)
    read: str | None = field(default=None, repr=False)
    """None: everyone who reaches the service may read."""
    admin: str | None = field(default=None, repr=False)

    def require(self, role: Role, authorization: bytes | None) -> None:
        """Let a request pass whose `Authorization` header opens what needs `role`.

        Raises
        ------
        ProblemError
            401 without a token, with one that is none of ours, or where nobody may; 403 with one that is for less.
        """
        if role is Role.OPEN or (role is Role.READ and self.read is None):
            return
        if self._tokens()[role] is None:
            raise _unauthorized(_REFUSED_WITHOUT[role])
        held = self._role_of(authorization or b"")
        if held is role or role is Role.READ:
            return
        detail = f"The token is for {held.purpose}; {role.purpose} takes the token of {role.option}."
        raise ProblemError(Problem(Kind.FORBIDDEN, detail))

    def knows(self, authorization: bytes) -> bool:
        """Say whether an `Authorization` header bears one of the tokens."""
        return self._held(authorization) is not None

    def _tokens(self) -> dict[Role, str | None]:
        return {Role.READ: self.read, Role.WRITE: self.write, Role.ADMIN: self.admin}

    def _role_of(self, authorization: bytes) -> Role:
        if authorization.partition(b" ")[0].lower() != b"bearer":
            raise _unauthorized(
                "Send the header `Authorization: Bearer TOKEN` with the token of the service's token file."
            )
        held = self._held(authorization)
        if held is None:
            raise _unauthorized("The token is not the one in the service's token file.")
        return held

    def _held(self, authorization: bytes) -> Role | None:
        scheme, _, given = authorization.partition(b" ")
        given = given.strip()
        # With every token, whichever fits: the time taken says nothing of them.
        fits = [
            role
            for role, token in self._tokens().items()
            if token is not None and hmac.compare_digest(given, token.encode())
        ]
        return fits[0] if fits and scheme.lower() == b"bearer" else None


def _unauthorized(detail: str) -> ProblemError:
    return ProblemError(Problem(Kind.UNAUTHORIZED, detail), _CHALLENGE)
