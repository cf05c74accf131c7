"""Requests of Modbus TCP and their answers, byte by byte as the standard has them."""

import pytest

from beamtouch_service.outputs.modbus.blocks import NoSuchRegisterError
from beamtouch_service.outputs.modbus.requests import NotModbusError, answer, frame_bytes, refuse


@pytest.mark.parametrize(
    ("rest_bytes", "length"),
    [(2, 8), (6, 12), (254, 260)],
)
def test_a_frame_ends_where_its_head_says(rest_bytes: int, length: int) -> None:
    assert frame_bytes(bytes([9, 9, 0, 0, 0, rest_bytes])) == length


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ("0901 0000 0001", "protocol 0, length 1"),
        ("0901 0000 00ff", "protocol 0, length 255"),
        ("0901 0000 0106", "protocol 0, length 262"),
        ("0901 0001 0006", "protocol 1, length 6"),
        ("0901 8000 0006", "protocol 32768, length 6"),
    ],
)
def test_bytes_that_begin_no_frame_are_named(head: str, words: str) -> None:
    with pytest.raises(NotModbusError, match=f"^{words}$"):
        frame_bytes(bytes.fromhex(head))


def read(address: int, count: int) -> list[int]:
    """Return registers that say where they are; there are 600."""
    if address + count > 600:
        raise NoSuchRegisterError
    return [address + place for place in range(count)]


@pytest.mark.parametrize(
    ("body", "answered"),
    [
        ("04 0102 0003", "0009 07 04 06 0102 0103 0104"),
        ("04 0257 0001", "0005 07 04 02 0257"),
        ("04 0257 0002", "0003 07 84 02"),
        ("04 0102 0000", "0003 07 84 03"),
        ("04 0102 007e", "0003 07 84 03"),
        ("04 0102 00", "0003 07 84 03"),
        ("04 0102 0003 00", "0003 07 84 03"),
        ("03 0102 0003", "0003 07 83 01"),
        ("05 0102 0003", "0003 07 85 01"),
        ("10 0102 0001 02 0000", "0003 07 90 01"),
    ],
)
def test_an_answer_repeats_transaction_and_unit_and_has_registers_or_an_exception(body: str, answered: str) -> None:
    frame = bytes.fromhex(f"1234 0000 {1 + len(bytes.fromhex(body)):04x} 07 {body}")
    assert answer(frame, read) == bytes.fromhex(f"1234 0000 {answered}")


def test_a_server_that_fails_says_so_of_the_function_that_was_asked_for() -> None:
    assert refuse(bytes.fromhex("1234 0000 0006 07 04 0102 0003")) == bytes.fromhex("1234 0000 0003 07 84 04")
