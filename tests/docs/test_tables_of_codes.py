"""Codes that the reference states in tables, and programs are written against, are those of the service."""

from itertools import takewhile

from beamtouch_service.outputs.modbus.registers import ON_PLATES, REGISTERS, STATES
from beamtouch_service.problems import Kind
from beamtouch_service.samples import Note
from support.pages.pasted import ROOT

REFERENCE = ROOT / "docs" / "reference"


def tables_under(page: str, *head: str) -> list[list[list[str]]]:
    """Return the rows of the tables of a page whose heads begin with these cells, without backquotes."""
    lines = (REFERENCE / page).read_text().splitlines()
    rows = [[cell.strip().replace("`", "") for cell in line.strip("|").split("|")] for line in lines]
    starts = [place for place, row in enumerate(rows) if row[: len(head)] == list(head)]
    return [list(takewhile(lambda row: len(row) > 1, rows[start + 2 :])) for start in starts]


def test_the_page_of_problems_has_type_status_and_title_of_each() -> None:
    (problems,) = tables_under("problems.md", "type", "status")
    stated = {uri: (int(status), title) for uri, status, title in problems}
    assert {kind.type_uri: (kind.status, kind.title) for kind in Kind} == stated


def test_the_page_of_registers_has_the_code_of_each_state_and_the_bit_of_each_note() -> None:
    (of_states,) = tables_under("registers.md", "state")
    states = {name: (int(code), meaning) for code, name, meaning in of_states}
    of_code = {key.slug if isinstance(key, Kind) else key.value: of for key, of in STATES.items()}
    assert {name: (code, meaning.replace("`", "")) for name, (code, meaning) in of_code.items()} == states
    (of_notes,) = tables_under("registers.md", "bit of notes")
    notes = {name: (int(bit), meaning) for bit, name, meaning in of_notes}
    assert {note.value: (note.bit, note.meaning.replace("`", "")) for note in Note} == notes


def test_the_page_of_registers_has_place_and_type_of_each() -> None:
    tables = tables_under("registers.md", "offset")
    for registers, rows in zip((REGISTERS, ON_PLATES), tables, strict=True):
        stated = {name: (tuple(map(int, place.split(" to "))), kind) for place, name, kind, _ in rows}
        assert {one.name: (ends_of(one.offset, one.type.count), one.type.text) for one in registers} == stated


def ends_of(offset: int, count: int) -> tuple[int, ...]:
    return (offset,) if count == 1 else (offset, offset + count - 1)
