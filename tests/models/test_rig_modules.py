"""The registers of the rig's Modbus module, against the byte orders and the floats of other sources; its delays."""

import asyncio
from collections.abc import Callable

import pytest

from beamtouch_common.errors import InputError
from beamtouch_models.lab.rig.devices import Module
from beamtouch_models.lab.rig.faults import Faults
from beamtouch_models.lab.rig.lines import Relay
from support.programs.in_process import Command

ORDERS = {
    "ABCD": [0x1234, 0x5678, 0x9ABC, 0xDEF0],
    "CDAB": [0x5678, 0x1234, 0xDEF0, 0x9ABC],
    "BADC": [0x3412, 0x7856, 0xBC9A, 0xF0DE],
    "DCBA": [0x7856, 0x3412, 0xF0DE, 0xBC9A],
}
"""0x12345678 and 0x9ABCDEF0 in registers, by the order of their bytes."""


FAULTS = "late:40@0..1", "lost:100@2..3", "pause@5..5.05"


@pytest.mark.parametrize("order", ORDERS)
def test_the_bytes_of_two_registers_come_in_the_stated_order(order: str) -> None:
    module = Module(type="u32", byte_order=order)
    assert module.registers_of([0x12345678, 0x9ABCDEF0]) == ORDERS[order]


@pytest.mark.parametrize(
    ("kind", "order", "registers"),
    [
        ("u16", "ABCD", [0x1234, 3]),
        ("u16", "CDAB", [0x1234, 3]),  # a value has no second register to swap with
        ("u16", "BADC", [0x3412, 0x0300]),
        ("i16", "ABCD", [0x1234, 3]),
        ("i32", "ABCD", [0, 0x1234, 0, 3]),
        ("f32", "ABCD", [0x4591, 0xA000, 0x4040, 0]),
        ("f64", "ABCD", [0x40B2, 0x3400, 0, 0, 0x4008, 0, 0, 0]),
        ("f64", "CDAB", [0, 0, 0x3400, 0x40B2, 0, 0, 0, 0x4008]),
    ],
)
def test_counts_have_the_form_of_their_type(kind: str, order: str, registers: list[int]) -> None:
    """4660 is 1.1377 x 2^12, and 3 is 1.5 x 2: their IEEE 754 forms by hand."""
    assert Module(type=kind, byte_order=order).registers_of([4660, 3]) == registers


def test_a_module_is_what_the_help_says_unless_it_is_told_otherwise(rig_here: Command) -> None:
    said = " ".join(rig_here("--help").stdout.split()).partition("registers of the Modbus module")[2]
    default = Module()
    for option, value in (
        ("unit", default.unit), ("function", default.function), ("register", default.register), ("type", default.type),
        ("byte-order", default.byte_order),
    ):  # fmt: skip
        assert f"(default: {value})" in said.partition(f"--{option} ")[2].partition(" --")[0], option


def test_the_last_register_of_a_module_is_65535() -> None:
    Module(register=65532).check(4, 16)
    Module(register=65528, type="f32").check(4, 24)
    with pytest.raises(InputError, match=r"--register 65533: 4 registers from there go beyond 65535"):
        Module(register=65533).check(4, 16)
    with pytest.raises(InputError, match=r"--register 65529: 8 registers from there go beyond 65535"):
        Module(register=65529, type="f32").check(4, 24)


@pytest.mark.parametrize(("kind", "bits"), [("i16", 15), ("u16", 16), ("i32", 31), ("u32", 32)])
def test_a_type_holds_the_counts_of_as_many_bits_as_it_has(kind: str, bits: int) -> None:
    Module(type=kind).check(2, bits)
    with pytest.raises(
        InputError, match=f"counts up to {2 ** (bits + 1) - 1} do not fit --type {kind}; set sensors.adc"
    ):
        Module(type=kind).check(2, bits + 1)


def test_replies_keep_their_order_when_a_delay_ends_and_requests_when_a_pause_does() -> None:
    seconds, passed = [0.0], list[str]()

    def note(word: str, done: asyncio.Event | None = None) -> Callable[[], None]:
        def act() -> None:
            passed.append(word)
            if done is not None:
                done.set()

        return act

    async def pass_on() -> list[str]:
        relay, replied, requested = Relay(Faults(["s1"], FAULTS), lambda: seconds[0]), asyncio.Event(), asyncio.Event()
        relay.reply(note("late"))
        seconds[0] = 1.5
        relay.reply(note("after it", replied))
        seconds[0] = 2.5
        relay.reply(note("lost"))
        seconds[0] = 4.0
        at_once = list(passed)
        await replied.wait()
        relay.reply(note("now"))
        seconds[0] = 5.0
        relay.request(note("waits"))
        seconds[0] = 6.0
        relay.request(note("behind it", requested))
        await requested.wait()
        relay.request(note("free"))
        return at_once

    assert asyncio.run(asyncio.wait_for(pass_on(), 60)) == []
    assert passed == ["late", "after it", "now", "waits", "behind it", "free"]
