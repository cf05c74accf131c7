"""One change on the trail, and the digest that chains it to the one before. Pure."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum

from beamtouch_service.callers import SERVICE

FIRST = ""
"""The digest before that of the first entry."""


class Action(StrEnum):
    """Kinds of changes."""

    START = "start"
    """A service started with another configuration, other options, other names of tokens, or of another version."""
    MODEL = "model"
    """A surface answers with another model."""
    TARE = "tare"
    """A daemon sends with other rest gaps or characteristics: after a tare, or with another configuration."""
    COMMISSIONING = "commissioning"
    """Somebody began, abandoned or confirmed a commissioning."""
    TOKEN = "token"  # noqa: S105  # a word
    """A token that may write is used from an address for the first time."""
    DELETION = "deletion"
    """The record deleted events, by its limits of age and size: at most one entry a day."""
    LOSS = "loss"
    """More changes than could be kept while the record was away, or more addresses than are watched."""


@dataclass(frozen=True)
class Entry:
    """One change."""

    at_us: int
    """When the service noticed it, by its clock [us since 1970]."""
    action: Action
    details: str
    """JSON object. An entry is added only if the last one of its action, surface and subject has other details."""
    surface: str = ""
    """Empty if it is of no single surface."""
    subject: str = ""
    """What it is of, beside the surface: of a token, its name and its address."""
    by: str = SERVICE
    """User, or name of the token."""
    token: str = ""
    """Name of the token; empty without one."""
    address: str = ""
    """Address of the client; empty without one."""

    @property
    def key(self) -> tuple[str, str, str]:
        """Action, surface and subject."""
        return self.action, self.surface, self.subject


def encode_details(details: Mapping[str, object]) -> str:
    """Return the details of an entry, the same text for the same details."""
    text = json.dumps(details, sort_keys=True, separators=(",", ":"), ensure_ascii=False)
    # Paths among the options may hold bytes that are no text. No database takes them.
    return text.encode("utf-8", "replace").decode()


def digest_of(before: object, number: object, values: Sequence[object]) -> str:
    """Return the digest (SHA-256) of an entry.

    Parameters
    ----------
    before : digest of the entry before
    number, values : its number, and its columns in their order; a damaged row may hold anything
    """
    content = json.dumps([before, number, *values], separators=(",", ":"), ensure_ascii=False, default=repr)
    return hashlib.sha256(content.encode("utf-8", "surrogatepass")).hexdigest()
