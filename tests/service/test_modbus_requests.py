"""Requests of Modbus TCP and their answers, byte by byte."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamtouch_service.outputs.modbus.blocks import NoSuchRegisterError
from beamtouch_service.outputs.modbus.requests import HEAD_BYTES, MAX_FRAME_BYTES, NotModbusError, answer, frame_bytes

LAST = 149


def read(address: int, count: int) -> list[int]:
    if address + count - 1 > LAST:
        raise NoSuchRegisterError
    return list(range(address, address + count))


def frame(body: bytes, transaction: int = 0x1234, unit: int = 7) -> bytes:
    return struct.pack(">HHHB", transaction, 0, 1 + len(body), unit) + body


def request(address: int, count: int) -> bytes:
    return struct.pack(">BHH", 4, address, count)


@pytest.mark.parametrize("unit", [0, 1, 7, 247, 255])
def test_registers_are_read_under_any_unit(unit: int) -> None:
    found = answer(frame(request(100, 3), unit=unit), read)

    assert found == bytes.fromhex("1234 0000 0009") + bytes([unit]) + bytes.fromhex("04 06 0064 0065 0066")


def test_the_most_registers_of_a_request_are_125() -> None:
    found = answer(frame(request(0, 125)), read)

    assert len(found) == 259
    assert found[9:] == struct.pack(">125H", *range(125))


@pytest.mark.parametrize(
    ("body", "exception"),
    [
        (request(150, 1), 2),
        (request(149, 2), 2),
        (request(65_535, 125), 2),
        (request(0, 0), 3),
        (request(0, 126), 3),
        (request(0, 65_535), 3),
        (b"\x04", 3),
        (b"\x04\x00\x00\x00", 3),
        (request(0, 1) + b"\x00", 3),
    ],
)
def test_a_wrong_range_has_the_exception_of_the_standard(body: bytes, exception: int) -> None:
    assert answer(frame(body), read) == bytes.fromhex("1234 0000 0003 07 84") + bytes([exception])


@pytest.mark.parametrize("function", [0, 1, 2, 3, 5, 6, 8, 15, 16, 17, 20, 21, 22, 23, 43, 99, 127, 0x84, 255])
def test_every_other_function_is_refused(function: int) -> None:
    found = answer(frame(bytes([function]) + bytes(8)), read)

    assert found == bytes.fromhex("1234 0000 0003 07") + bytes([function | 0x80, 1])


@given(body=st.binary(min_size=1, max_size=253), transaction=st.integers(0, 65_535), unit=st.integers(0, 255))
def test_every_frame_has_one_whole_answer(body: bytes, transaction: int, unit: int) -> None:
    asked = frame(body, transaction, unit)
    assert frame_bytes(asked[:HEAD_BYTES]) == len(asked)
    found = answer(asked, read)

    assert frame_bytes(found[:HEAD_BYTES]) == len(found) <= MAX_FRAME_BYTES
    assert (found[:4], found[6]) == (asked[:4], unit)
    assert found[7] in (body[0], body[0] | 0x80)


@pytest.mark.parametrize("head", ["000100010006", "000180000006", "000000000000", "000000000001", "0000000000ff"])
def test_other_bytes_begin_no_frame(head: str) -> None:
    with pytest.raises(NotModbusError):
        frame_bytes(bytes.fromhex(head))
