"""The register map, from which the server fills its registers and the documentation is made.

Registers of figures come from the table of fields; here is what only Modbus has.

Controllers are programmed against these numbers. A register keeps its offset, its type and its meaning for good; new
ones take offsets that are free.
"""

from binascii import crc_hqx
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from math import ceil

from beamtouch_common.outline import BEAM_AXES, PLATE_AXES
from beamtouch_common.zones import MAX_ZONES, ZoneState
from beamtouch_models.runtime import State
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Note, Quality
from beamtouch_service.surfaces.fields import Cell, Field, fields_of
from beamtouch_service.surfaces.view import View

BLOCK = 60
"""Registers of one surface. Those without a meaning yet read as 0."""
MAX_SURFACES = 65_536 // BLOCK
"""More blocks do not fit in the addresses of Modbus."""
MAX_UINT16, MAX_UINT32 = 0xFFFF, 0xFFFF_FFFF
CONSTANT = 1234.5
"""A figure in the wrong word order may look right: 276.5215 becomes 96.6. This one does not."""
_HEARTBEAT_PER_S = 10

STATES: dict[State | Kind, tuple[int, str]] = {
    State.CLEAR: (1, "the beam rests"),
    State.CONTACT: (2, "one contact; position and force hold"),
    State.UNEXPLAINED: (3, "something acts on the surface that is not one contact, or a sensor is wrong"),
    Kind.NO_MODEL: (16, "the surface has no model"),
    Kind.NO_SAMPLES: (17, "no sample has arrived since the service started"),
    Kind.STALE: (18, "the newest sample is older than the limit of the surface (`stale_ms`)"),
    Kind.TOO_FEW_CHANNELS: (19, "too few channels work"),
    Kind.UNUSABLE_ESTIMATE: (20, "the model gave no usable answer"),
    Kind.OTHER_BEAM: (21, "the model is of another beam than the samples that arrive"),
}
"""Codes of the register `state`. 0 is no code, because memory that was never written holds it."""


ZONE_CODES = {None: 0, ZoneState.OUTSIDE: 1, ZoneState.UNSURE: 2, ZoneState.INSIDE: 3}
"""Codes of the two bits of a zone. 0 is also that of a zone that is not configured."""


class Type(Enum):
    """Types of registers: name, and how many registers of 16 bits one takes."""

    UINT16 = ("uint16", 1)
    UINT32 = ("uint32", 2)
    FLOAT32 = ("float32", 2)
    NOTES = ("bits", 1)
    CHANNELS = ("channel bits", 4)
    ZONES = ("zone bits", 1)

    def __init__(self, text: str, count: int) -> None:
        self.text = text
        self.count = count


@dataclass(frozen=True, slots=True)
class Register:
    """One value of the block of a surface."""

    offset: int
    """Of its first register in the block."""
    name: str
    type: Type
    meaning: str
    value: Callable[[View], float]


def identity(surface: str) -> int:
    """Return the identity of a surface: the CRC-16/XMODEM of its name."""
    return crc_hqx(surface.encode(), 0)


def _of_field(field: Field, cell: Cell) -> Register:
    """Return the registers of a field of the contact. Rounded up, no sample seems younger than it is."""

    def value(view: View) -> float:
        figure: float | None = field.get(view)
        if figure is None:
            return cell.absent
        if cell.type == "uint16":
            return min(max(ceil(figure), 0), MAX_UINT16)
        return int(figure) & MAX_UINT32 if cell.type == "uint32" else figure

    return Register(cell.offset, field.name, Type[cell.type.upper()], cell.words, value)


def _quality(offset: int, quality: Quality, meaning: str) -> Register:
    def bits(view: View) -> int:
        return _bits(view, {name for name, bad in view.bad.items() if bad is quality})

    return Register(offset, quality.value.replace("-", "_"), Type.CHANNELS, meaning, bits)


def _check(view: View) -> int:
    return _bits(view, {note.removeprefix("check-") for note in view.notes if note.startswith("check-")})


def _bits(view: View, names: set[str]) -> int:
    """Return a bit for each of these channels, the first channel of the model in the lowest bit."""
    # Almost always there are none.
    if not names or view.model is None:
        return 0
    return sum(1 << place for place, name in enumerate(view.model.channels) if name in names)


def _notes(view: View) -> int:
    notes = view.notes
    return sum(1 << note.bit for note in Note if note in notes)


def _zones(view: View) -> int:
    return sum(ZONE_CODES[state] << 2 * place for place, state in enumerate(view.zones.values()))


def _entries(place: int) -> Register:
    def value(view: View) -> int:
        counts = list(view.totals.zone_entries.values())
        return counts[place] & MAX_UINT16 if place < len(counts) else 0

    meaning = f"entries into zone {place + 1} since the service started; wraps to 0 after 65535"
    return Register(43 + place, f"zone_{place + 1}_entries", Type.UINT16, meaning, value)


_OWN = (
    Register(
        0,
        "identity",
        Type.UINT16,
        "CRC-16/XMODEM of the surface's name; compare it before you trust the block",
        lambda view: identity(view.surface),
    ),
    Register(
        1,
        "heartbeat",
        Type.UINT16,
        "counts up 10 times a second and wraps to 0 after 65535",
        lambda view: int(view.now_s * _HEARTBEAT_PER_S) & MAX_UINT16,
    ),
    Register(
        2,
        "state",
        Type.UINT16,
        "see below; position and force are numbers only with 2",
        lambda view: STATES[view.status][0],
    ),
    Register(3, "notes", Type.NOTES, "see below; 0 from state 16 on", _notes),
    Register(
        20,
        "constant",
        Type.FLOAT32,
        "always 1234.5; a program that reads another value has the wrong word order",
        lambda _: CONSTANT,
    ),
    Register(
        22,
        "check",
        Type.CHANNELS,
        "the channel that contradicts the others (`check-NAME`); only with state 3",
        _check,
    ),
    _quality(26, Quality.OUT_OF_RANGE, "channels whose gap is outside the range of the sensor"),
    _quality(30, Quality.SATURATED, "channels whose counts stand at the end of the ADC"),
    _quality(34, Quality.STUCK, "channels whose counts have not changed for too long"),
    _quality(38, Quality.MISSING, "channels without readings"),
    Register(
        42,
        "zones",
        Type.ZONES,
        "2 bits a zone, zone 1 lowest: 1 outside, 2 unsure, 3 inside, 0 no answer or no such zone",
        _zones,
    ),
    *(_entries(place) for place in range(MAX_ZONES)),
)
"""Registers beside those of the fields."""


@cache
def registers_of(axes: tuple[str, ...]) -> tuple[Register, ...]:
    """Return the block of a surface with these axes. One with a single axis has the registers of a second, too."""
    named = axes if len(axes) > 1 else (*axes, PLATE_AXES[1])
    fields = [_of_field(field, field.register) for field in fields_of(named) if field.register]
    return tuple(sorted([*_OWN, *fields], key=lambda register: register.offset))


REGISTERS = registers_of(BEAM_AXES)
"""The block of a beam."""
ON_PLATES = [one for one in registers_of(PLATE_AXES) if one.name not in {other.name for other in REGISTERS}]
"""The registers that have another name on a plate."""
