"""The register map as text and JSON, as `beamtouch-service registers` prints it; a page of the site repeats it."""

import json
from collections.abc import Mapping
from typing import Any

from beamtouch_common.table import aligned_markdown
from beamtouch_service.outputs.modbus.registers import BLOCK, REGISTERS, STATES, identity
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Note
from beamtouch_service.sections import SurfaceSection


def as_json(surfaces: Mapping[str, SurfaceSection], word_order: str) -> str:
    """Return the map as one JSON object, with the blocks of these surfaces in their order."""
    return json.dumps(describe(surfaces, word_order))


def describe(surfaces: Mapping[str, SurfaceSection], word_order: str) -> dict[str, Any]:
    """Return the map as JSON values."""
    registers = [
        {"offset": one.offset, "name": one.name, "type": one.type.text, "registers": one.type.count}
        | {"meaning": one.meaning}
        for one in REGISTERS
    ]
    return {
        "function": 4,
        "registers_per_surface": BLOCK,
        "word_order": word_order,
        "registers": registers,
        "states": {_state_name(state): code for state, (code, _) in STATES.items()},
        "notes": {note.value: note.bit for note in Note},
        "surfaces": [
            {"surface": name, "address": place * BLOCK, "identity": identity(name)}
            | ({"zones": list(section.zones)} if section.zones else {})
            for place, (name, section) in enumerate(surfaces.items())
        ],
    }


def as_text(surfaces: Mapping[str, SurfaceSection], word_order: str) -> str:
    """Return the map as Markdown tables, with the blocks of these surfaces in their order."""
    registers = [(_range(one.offset, one.type.count), f"`{one.name}`", one.type.text, one.meaning) for one in REGISTERS]
    states = [(str(code), f"`{_state_name(state)}`", words) for state, (code, words) in STATES.items()]
    parts = [
        f"Input registers (function 4). Each surface has a block of {BLOCK}; offsets count from its first register.",
        aligned_markdown(("offset", "register", "type", "value"), registers),
        aligned_markdown(("state", "name", "meaning"), states),
        aligned_markdown(
            ("bit of `notes`", "note", "meaning"), [(str(one.bit), f"`{one}`", one.meaning) for one in Note]
        ),
    ]
    if surfaces:
        blocks = [
            (f"`{name}`", _range(place * BLOCK, BLOCK), str(identity(name))) for place, name in enumerate(surfaces)
        ]
        parts += [aligned_markdown(("surface", "addresses", "identity"), blocks), f"Word order: {word_order}."]
    if rows := _zones(surfaces):
        parts.append(aligned_markdown(("surface", "zone", "name", "inside if", "entries"), rows))
    return "\n\n".join(parts)


def _zones(surfaces: Mapping[str, SurfaceSection]) -> list[tuple[str, ...]]:
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
        for block, (name, section) in enumerate(surfaces.items())
        for place, zone in enumerate(section.zones)
    ]


def _state_name(state: object) -> str:
    return state.slug if isinstance(state, Kind) else str(state)


def _range(first: int, count: int) -> str:
    return str(first) if count == 1 else f"{first} to {first + count - 1}"
