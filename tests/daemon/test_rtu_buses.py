"""A bus with its units: what they share, how long one rests, and what nothing can prove."""

import pytest

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.config.sources import ModbusRtu
from beamtouch_daemon.sources.registers import Block
from beamtouch_daemon.sources.rtu_bus import COPIES, RtuBus, RtuLink
from beamtouch_daemon.sources.rtu_frames import silence_of

from .devices import with_crc
from .lines import terminal

pytestmark = pytest.mark.anyio

BLOCKS = [Block(30, 2)]


def bus_of(path: str = "/dev/x", **keys: object) -> RtuBus:
    return RtuBus(ModbusRtu.model_validate({"kind": "modbus-rtu", "port": path} | keys))


def link_of(bus: RtuBus, address: int = 7, timeout_s: float = 0.1) -> RtuLink:
    return RtuLink(bus, address, BLOCKS, timeout_s)


async def test_users_of_one_unit_share_it_and_those_of_another_do_not() -> None:
    bus = bus_of()
    assert bus.unit(7) is bus.unit(7) is not bus.unit(8)
    assert bus.unit(7).address == 7
    assert link_of(bus).name == "unit 7"


@pytest.mark.parametrize(("timeout_s", "rest_s"), [(0.01, 0.5), (0.038, 0.5), (0.04, 0.52), (0.1, 1.3)])
async def test_a_unit_that_was_given_up_rests_for_half_a_second_or_13_timeouts(timeout_s: float, rest_s: float) -> None:
    assert link_of(bus_of(), timeout_s=timeout_s).rest_s == pytest.approx(rest_s)


async def test_what_cannot_be_proven_is_said_with_how_long_a_unit_is_left_alone() -> None:
    bus = bus_of()
    link = link_of(bus, timeout_s=0.75)
    assert list(link.limits) == [COPIES]
    bus.unit(7)._probes = []
    assert list(link.limits) == [
        "unit 7 answers only requests for its values, so a late answer looks like a new one. After a missing answer it "
        "is not polled for 7.5 s; an answer that comes even later counts as a new one.",
        COPIES,
    ]


@pytest.mark.parametrize(
    ("baud", "silence_s"), [(9600, 38.5 / 9600), (19_200, 38.5 / 19_200), (19_201, 38.5 / 19_201), (115_200, 0.00175)]
)
def test_the_silence_between_frames_is_that_of_the_standard(baud: int, silence_s: float) -> None:
    # 3.5 characters of 11 bits, and 1.75 ms above 19 200 baud: Modbus over Serial Line 1.02, chapter 2.5.1.1.
    assert silence_of(baud) == pytest.approx(silence_s)


@pytest.mark.parametrize(
    ("keys", "silence_s"), [({}, 0.00175), ({"silence_ms": 7.5}, 0.0075), ({"silence_ms": 0.0}, 0.0)]
)
async def test_a_stated_silence_overrides_that_of_the_standard(keys: dict[str, object], silence_s: float) -> None:
    with terminal() as port:
        async with bus_of(port.path, **keys).used() as line:
            assert line._silence_s == silence_s


async def test_a_session_through_a_new_port_begins_with_what_is_not_known_of_all_units() -> None:
    with terminal() as port:
        bus = bus_of(port.path)
        link = link_of(bus)
        async with link.opened():
            begun_s = uptime_s()
            assert link.observed == "the port is open, but not a byte came; check supply and wiring"
            assert 0 < link.boots_until_s - begun_s <= 8.0
            assert bus.unit(7).blocks == set(BLOCKS)
            async with bus.used() as one, bus.used() as same:
                assert one is same
        bus.unit(7)._owed = type(bus.unit(7)._owed)(0)
        async with bus.used() as other:
            assert other is not one
        assert bus.unit(7)._owed != 0


async def test_values_that_nobody_waits_for_make_their_unit_suspect() -> None:
    bus = bus_of()
    for address in (7, 8):
        bus.unit(address).will_be_asked(BLOCKS)
        bus.unit(address)._owed = type(bus.unit(address)._owed)(0)
    for data in (bytes([7, 4, 2, 0, 1]), bytes([9, 4, 4, 0, 1, 0, 2]), bytes([8, 4, 4, 0, 1, 0, 2])):
        bus._take_unexpected(b"\xff" + with_crc(data))
    suspected = [bus.unit(address)._suspect_until_s > uptime_s() for address in (7, 8)]
    assert suspected == [False, True]  # an answer of another length, and one of a unit that nobody reads, say nothing
