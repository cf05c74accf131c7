"""Which registers are asked for together, and what their contents mean."""

import math
import struct
from typing import Literal, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.client.mixin import ModbusClientMixin

from beamtouch_daemon.config.modules import module_of, names
from beamtouch_daemon.config.value_types import ByteOrder, ValueType, ends_of, words_of
from beamtouch_daemon.sources.registers import Block, RegisterAnswer, Value, answer_to, blocks_of

WORD_ORDERS: tuple[tuple[ByteOrder, Literal["big", "little"]], ...] = (("ABCD", "big"), ("CDAB", "little"))
"""Orders of bytes that pymodbus has, and its names for them."""


def words(*registers: int) -> list[Value]:
    return [Value(register) for register in registers]


def test_registers_in_a_row_are_one_request() -> None:
    assert blocks_of(words(3, 1, 2)) == (Block(1, 3),)
    assert blocks_of(words(0, 1, 7)) == (Block(0, 2), Block(7, 1))
    assert blocks_of(words(*range(126))) == (Block(0, 125), Block(125, 1))
    assert blocks_of(words(*range(8)), max_registers=3) == (Block(0, 3), Block(3, 3), Block(6, 2))
    assert blocks_of([Value(register, "u32") for register in (0, 2, 4)], max_registers=5) == (Block(0, 4), Block(4, 2))


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    "Up to this many unused registers are read along to save a request",
)
def test_a_gap_is_read_along_only_where_that_is_allowed() -> None:
    assert blocks_of(words(0, 3, 9), bridge=2) == (Block(0, 4), Block(9, 1))
    assert blocks_of(words(0, 3, 9), bridge=5) == (Block(0, 10),)
    assert blocks_of(words(0, 3, 9), max_registers=9, bridge=5) == (Block(0, 4), Block(9, 1))


@pytest.mark.promise("docs/reference/daemon-configuration.md", "Limit of registers in one request")
@given(st.sets(st.integers(0, 300), min_size=1), st.integers(1, 125), st.integers(0, 10))
def test_blocks_hold_every_register_within_the_limits(registers: set[int], most: int, bridge: int) -> None:
    blocks = blocks_of(words(*registers), most, bridge)
    held = [register for block in blocks for register in range(block.first, block.first + block.count)]
    assert set(held) >= registers
    assert len(held) == len(set(held))
    assert max(block.count for block in blocks) <= most
    assert {block.first for block in blocks} <= registers


@pytest.mark.parametrize(
    ("value_type", "value"),
    [("u16", 40_000), ("i16", -3), ("u32", 3_000_000_000), ("i32", -70_000), ("f32", -1.5), ("f64", -1.5e-3)],
)
def test_values_are_those_that_pymodbus_writes(value_type: ValueType, value: float) -> None:
    types = {"u16": "UINT16", "i16": "INT16", "u32": "UINT32", "i32": "INT32", "f32": "FLOAT32", "f64": "FLOAT64"}
    kind = getattr(ModbusClientMixin.DATATYPE, types[value_type])
    for order, word_order in WORD_ORDERS:
        registers = ModbusClientMixin.convert_to_registers(value, kind, word_order)
        contents = dict(enumerate(registers, 7))
        assert Value(7, value_type, order).decode(contents) == value


@given(
    st.floats(width=32, allow_nan=False, allow_infinity=False),
    st.sampled_from(get_args(ValueType)),
    st.sampled_from(get_args(ByteOrder)),
)
def test_registers_hold_what_was_put_into_them(number: float, value_type: ValueType, order: ByteOrder) -> None:
    low, high = ends_of(value_type)
    kept = number if value_type.startswith("f") else float(round(min(max(number, low), high)))
    value = Value(7, value_type, order)
    registers = value.encode(kept)
    assert value.decode(dict(enumerate(registers, 7))) == kept
    assert len(registers) == words_of(value_type)


@pytest.mark.promise(
    "docs/reference/daemon-configuration.md",
    (
        "BADC and DCBA also swap 16-bit values. Of f64, CDAB and DCBA reverse the four registers, BADC and DCBA swap "
        "the bytes of each."
    ),
)
@pytest.mark.parametrize("order", ["ABCD", "CDAB", "BADC", "DCBA"])
def test_byte_orders_are_named_after_where_each_byte_stands(order: ByteOrder) -> None:
    data = bytes("ABCD".index(letter) + 1 for letter in order)
    contents = dict(enumerate(struct.unpack(">2H", data)))
    assert Value(0, "u32", order).decode(contents) == 0x01020304


def test_a_missing_register_and_nan_are_no_value() -> None:
    assert Value(3).decode({2: 1}) is None
    assert Value(3, "u32").decode({3: 1}) is None
    for strange in (math.nan, math.inf):
        first, second = struct.unpack(">2H", struct.pack(">f", strange))
        assert Value(0, "f32").decode({0: first, 1: second}) is None


def test_every_module_is_whole() -> None:
    assert set(names()) == {"adam-6017", "generic", "iologik-e1240", "waveshare-8ch"}
    for name in names():
        module = module_of(name)
        assert module.register_of(module.inputs - 1) + words_of(module.type) - 1 <= 65_535
    with pytest.raises(ValueError, match="there is no module nonesuch; choose one of adam-6017, "):
        module_of("nonesuch")


TWO = Block(30, 2)


@pytest.mark.parametrize(
    ("block", "data", "answer"),
    [
        (TWO, b"\4\4\0\7\1\x08", RegisterAnswer([7, 264])),
        (Block(30, 2, 3), b"\3\4\0\7\1\x08", RegisterAnswer([7, 264])),
        (TWO, b"\3\4\0\7\1\x08", None),  # of another function
        (TWO, b"\4\2\0\7", None),  # of fewer registers
        (TWO, b"\4\6\0\7\0\7\0\7", None),
        (TWO, b"\x84\2", RegisterAnswer(exception=2)),
        (TWO, b"\x83\2", None),
        (TWO, b"\x55\1", None),  # Modbus has no such function
        (Block(30, 8, 1), b"\1\1\xff", RegisterAnswer()),  # contents of coils are left out
        (Block(30, 8, 2), b"\x82\x0b", RegisterAnswer(exception=11)),
    ],
)
def test_an_answer_is_that_to_a_request_by_its_function_and_its_length(
    block: Block, data: bytes, answer: RegisterAnswer | None
) -> None:
    assert answer_to(block, data, 50.0) == (None if answer is None else answer._replace(asked_s=50.0))


def test_a_request_has_its_function_its_first_register_and_their_number() -> None:
    assert Block(0x0102, 0x0304, 3).request == b"\3\1\2\3\4"
    assert Block(7, 1).request == b"\4\0\7\0\1"


def test_refusals_of_function_address_and_number_last_and_others_may_pass() -> None:
    passing = [code for code in range(13) if RegisterAnswer(exception=code).may_pass]
    assert passing == [4, 5, 6, 7, 8, 9, 10, 11, 12]
    assert not RegisterAnswer((7,)).may_pass
