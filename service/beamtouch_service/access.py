"""Access control: two bearer tokens and the requests that each allows. Pure: no web framework, no clock, no I/O."""

import hmac
from dataclasses import dataclass, field
from enum import Enum

from beamtouch_service.problems import Kind, Problem, ProblemError

_CHALLENGE = {"WWW-Authenticate": 'Bearer realm="beamtouch"'}


class Role(Enum):
    """The right that a request needs: a token with its name, and the option with the file of the token."""

    OPEN = ("", "")
    READ = ("read", "--read-token-file")
    WRITE = ("write", "--write-token-file")

    def __init__(self, token: str, option: str) -> None:
        self.token = token
        self.option = option


_NO_WRITES = "Writes are disabled. To enable them, start the service with --write-token-file FILE."


@dataclass(frozen=True)
class Access:
    """The tokens of a service, None where there is none. The write token can also read."""

    write: str | None = field(default=None, repr=False)
    read: str | None = field(default=None, repr=False)
    """None: reads need no token."""

    def require(self, role: Role, authorization: bytes | None) -> None:
        """Let a request pass whose `Authorization` header has a token for `role`.

        Raises
        ------
        ProblemError
            401 without a valid token, or if the role is disabled; 403 with a token for another role.
        """
        if role is Role.OPEN or (role is Role.READ and self.read is None):
            return
        if role is Role.WRITE and self.write is None:
            raise _unauthorized(_NO_WRITES)
        held = self._role_of(authorization or b"")
        if held is role or role is Role.READ:
            return
        detail = f"This is the {held.token} token. Use the {role.token} token ({role.option})."
        raise ProblemError(Problem(Kind.FORBIDDEN, detail))

    def _role_of(self, authorization: bytes) -> Role:
        scheme, _, given = authorization.partition(b" ")
        if scheme.lower() != b"bearer":
            raise _unauthorized("Send the header `Authorization: Bearer TOKEN` with a token of the service.")
        # Compares with every token, so that the time it takes tells nothing about them.
        roles = [
            role
            for role, token in ((Role.READ, self.read), (Role.WRITE, self.write))
            if token is not None and hmac.compare_digest(given.strip(), token.encode())
        ]
        if not roles:
            raise _unauthorized("This is not a token of the service. Check its token files.")
        return roles[0]


def _unauthorized(detail: str) -> ProblemError:
    return ProblemError(Problem(Kind.UNAUTHORIZED, detail), _CHALLENGE)
