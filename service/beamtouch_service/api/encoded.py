"""Contacts as JSON bytes, encoded once per sample. Only the age is put in at each answer."""

from dataclasses import dataclass

from prometheus_client import Counter

from beamtouch_service.surfaces.contact import Contact
from beamtouch_service.surfaces.surface import Surface


@dataclass(frozen=True, slots=True)
class _Encoded:
    """A contact without its age."""

    basis: object
    """The newest sample that it was encoded from."""
    before: bytes
    after: bytes
    counter: Counter
    """Counts the contacts of this surface and state."""


class EncodedContacts:
    """The contacts of all surfaces as JSON."""

    def __init__(self, counter: Counter) -> None:
        self._counter = counter
        self._encoded: dict[str, _Encoded] = {}

    def get(self, surface: Surface, now_s: float) -> bytes:
        """Return the contact on a surface as of `now_s` [s] and count it; raises ProblemError if there is none."""
        encoded, newest = self._encoded.get(surface.name), surface.newest
        if encoded is None or newest is None or encoded.basis is not newest or surface.is_stale(now_s):
            encoded = self._encode(surface, surface.contact(now_s))
            newest = surface.newest
        assert newest is not None  # noqa: S101  # a surface with a contact has a sample
        encoded.counter.inc()
        return b"%b%r%b" % (encoded.before, newest.age_ms(now_s), encoded.after)

    def _encode(self, surface: Surface, contact: Contact) -> _Encoded:
        before, _, after = contact.model_dump_json().partition(f'"age_ms":{contact.age_ms!r}')
        counter = self._counter.labels(surface.name, contact.state.value)
        encoded = _Encoded(surface.newest, f'{before}"age_ms":'.encode(), after.encode(), counter)
        self._encoded[surface.name] = encoded
        return encoded
