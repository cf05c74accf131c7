"""PROTOCOL.md agrees with the code."""

import re
from pathlib import Path

import pytest

from beamtouch_protocol.framing import MAX_FRAME_BYTES, encode
from beamtouch_protocol.messages import MESSAGE_TYPES, SCHEMA_HASH, SCHEMA_TEXT, Reading, Start

DOCUMENT = (Path(__file__).parents[2] / "firmware_protocol" / "PROTOCOL.md").read_text()


def table_rows(section: str) -> list[list[str]]:
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines() if line[:1] == "|"]
    return rows[2:]


def section(heading: str) -> str:
    return DOCUMENT.split(heading, 1)[1].split("\n#", 1)[0]


def test_the_schema_text_and_its_hash_are_those_of_the_code() -> None:
    assert DOCUMENT.split("```schema\n", 1)[1].split("```", 1)[0] == SCHEMA_TEXT
    assert set(re.findall(r"0x[0-9A-F]{8}", section("### Schema hash"))) == {f"0x{SCHEMA_HASH:08X}"}


@pytest.mark.parametrize("number", MESSAGE_TYPES)
def test_every_message_has_a_table_of_its_fields(number: int) -> None:
    message = MESSAGE_TYPES[number]
    offset = 0
    expected = []
    for name, kind in message.FIELDS:
        expected.append([str(offset), name, str(kind)])
        offset += kind.max_bytes
    assert [row[:3] for row in table_rows(section(f"### {message.__name__} (0x{number:02x})"))] == expected


def test_the_worked_example_ends_in_the_frame_of_the_code() -> None:
    steps = dict(table_rows(section("### Worked example")))
    assert bytes.fromhex(steps["frame with its delimiter"].strip("`")) == encode(Start(100, 16))


def test_the_timing_table_counts_the_bytes_of_real_frames() -> None:
    for channels, length, fast, slow in table_rows(section("## Timing")):
        frame = encode(Reading(1, 1, 1, (1,) * int(channels)))
        assert len(frame) == int(length)
        assert (int(fast), int(slow)) == (100_000 // len(frame), 11_520 // len(frame))


def test_the_longest_frame_is_the_one_the_decoder_holds() -> None:
    assert f"the longest frame is {MAX_FRAME_BYTES} bytes" in DOCUMENT
