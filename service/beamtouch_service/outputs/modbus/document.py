"""The register map as text and JSON, as `beamtouch-service registers` prints it; a page of the site repeats it."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from beamtouch_common.outline import PLATE_AXES
from beamtouch_common.table import aligned_markdown
from beamtouch_service.outputs.modbus.registers import (
    BLOCK,
    ON_PLATES,
    REGISTERS,
    STATES,
    Register,
    identity,
    registers_of,
)
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Note
from beamtouch_service.sections import SurfaceSection


class Block(NamedTuple):
    """The block of a surface."""

    section: SurfaceSection
    axes: tuple[str, ...]
    """Of its model; of a beam as long as none can be read."""


Blocks = Mapping[str, Block]
"""The blocks of surfaces by their names, in their order."""


def as_json(blocks: Blocks, word_order: str) -> str:
    """Return the map as one JSON object, with these blocks."""
    return json.dumps(describe(blocks, word_order))


def describe(blocks: Blocks, word_order: str) -> dict[str, Any]:
    """Return the map as JSON values. `registers_of_plates` are those that have another name on a plate."""
    return {
        "function": 4,
        "registers_per_surface": BLOCK,
        "word_order": word_order,
        "registers": [_described(one) for one in REGISTERS],
        "registers_of_plates": [_described(one) for one in ON_PLATES],
        "states": {_state_name(state): code for state, (code, _) in STATES.items()},
        "notes": {note.value: note.bit for note in Note},
        "surfaces": [
            {"surface": name, "address": place * BLOCK, "identity": identity(name), "axes": list(block.axes)}
            | ({"zones": list(block.section.zones)} if block.section.zones else {})
            for place, (name, block) in enumerate(blocks.items())
        ],
    }


def _described(one: Register) -> dict[str, Any]:
    described = {"offset": one.offset, "name": one.name, "type": one.type.text, "registers": one.type.count}
    return described | {"meaning": one.meaning}


def as_text(blocks: Blocks, word_order: str) -> str:
    """Return the map as Markdown tables, with these blocks. If all are of plates, it has the names of plates."""
    axes = {block.axes for block in blocks.values()}
    registers = [_table_of(registers_of(PLATE_AXES) if axes == {PLATE_AXES} else REGISTERS)]
    if len(axes) != 1:
        registers += ["On a plate, these registers have other names:", _table_of(ON_PLATES)]
    states = [(str(code), f"`{_state_name(state)}`", words) for state, (code, words) in STATES.items()]
    parts = [
        f"Input registers (function 4). Each surface has a block of {BLOCK}; offsets count from its first register.",
        *registers,
        aligned_markdown(("state", "name", "meaning"), states),
        aligned_markdown(
            ("bit of `notes`", "note", "meaning"), [(str(one.bit), f"`{one}`", one.meaning) for one in Note]
        ),
    ]
    if blocks:
        addresses = [
            (f"`{name}`", _range(place * BLOCK, BLOCK), str(identity(name)), ", ".join(block.axes))
            for place, (name, block) in enumerate(blocks.items())
        ]
        parts += [
            aligned_markdown(("surface", "addresses", "identity", "axes"), addresses),
            f"Word order: {word_order}.",
        ]
    if rows := _zones(blocks):
        parts.append(aligned_markdown(("surface", "zone", "name", "inside if", "entries"), rows))
    return "\n\n".join(parts)


def _table_of(registers: Sequence[Register]) -> str:
    rows = [(_range(one.offset, one.type.count), f"`{one.name}`", one.type.text, one.meaning) for one in registers]
    return aligned_markdown(("offset", "register", "type", "value"), rows)


def _zones(blocks: Blocks) -> list[tuple[str, ...]]:
    """Return a row for each zone: which bits are set while it is inside, and the address of its counter."""
    offsets = {one.name: one.offset for one in REGISTERS}
    return [
        (
            f"`{name}`",
            str(place + 1),
            f"`{zone}`",
            f"bits {2 * place} and {2 * place + 1} of address {block * BLOCK + offsets['zones']} are both set",
            f"address {block * BLOCK + offsets[f'zone_{place + 1}_entries']}",
        )
        for block, (name, (section, _)) in enumerate(blocks.items())
        for place, zone in enumerate(section.zones)
    ]


def _state_name(state: object) -> str:
    return state.slug if isinstance(state, Kind) else str(state)


def _range(first: int, count: int) -> str:
    return str(first) if count == 1 else f"{first} to {first + count - 1}"
