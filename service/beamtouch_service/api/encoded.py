"""Contacts as bytes: encoded once per sample, with only the age put in at each answer."""

from dataclasses import dataclass

from beamtouch_service.problems import ProblemError
from beamtouch_service.surfaces.registry import Registry
from beamtouch_service.surfaces.surface import Surface


@dataclass(frozen=True)
class _Encoded:
    """An answer around its age."""

    basis: object
    """What it follows from; another object once that has changed."""
    acquired_s: float
    counted: tuple[str, str]
    """Surface and state."""
    before: bytes
    after: bytes


class EncodedContacts:
    """The contacts of all surfaces, encoded when they are first asked for."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._encoded: dict[str, _Encoded] = {}

    def get(self, name: str | None, now_s: float) -> tuple[tuple[str, str], bytes] | None:
        """Return surface and state, and the JSON, of the contact on the surface of that name, or on the only one.

        As of `now_s` [s]; None where there is none to give, for whatever reason.
        """
        surface = self._registry.find(name)
        if surface is None:
            return None
        encoded = self._encoded.get(surface.name)
        if encoded is None or encoded.basis is not surface.newest:
            encoded = _encode(surface, now_s)
            if encoded is None:
                return None
            self._encoded[surface.name] = encoded
        age_s = now_s - encoded.acquired_s
        # As the surface itself compares and rounds.
        if age_s * 1e3 > surface.stale_ms:
            return None
        return encoded.counted, b"%b%r%b" % (encoded.before, round(age_s * 1e3, 1), encoded.after)


def _encode(surface: Surface, now_s: float) -> _Encoded | None:
    basis = surface.newest
    try:
        contact = surface.contact(now_s)
    except ProblemError:
        return None
    if basis is None:
        return None
    age = f'"age_ms":{contact.age_ms!r}'
    counted = surface.name, contact.state.value
    before, _, after = contact.model_dump_json().partition(age)
    return _Encoded(basis, basis.acquired_s, counted, f'{before}"age_ms":'.encode(), after.encode())
