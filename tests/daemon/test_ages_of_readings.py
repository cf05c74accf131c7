"""A reading of several requests is as old as the first of them: no value in it is older than it says."""

import pytest

from .devices import StampingUnit, rtu_units, tcp_unit
from .lines import terminal
from .sessions import source_in, take_across_sessions

pytestmark = pytest.mark.anyio

LATE_S = 0.05
"""Between a request and its answer, which other requests wait for."""
EXACT_S = 0.002
"""Values are whole milliseconds."""
APART = [0, 1000, 2000]
"""Registers that no single request reads."""


def late() -> StampingUnit:
    """Return a unit whose values are the times of their requests, and which takes its time to answer."""
    return StampingUnit(lambda _number, frame: [(LATE_S, frame)])


async def test_units_that_share_a_bus_are_asked_one_after_the_other() -> None:
    with terminal() as line:
        units = {address: late() for address in (1, 2, 3)}
        async with rtu_units(line, units):
            source = f'kind = "modbus-rtu"\nport = "{line.path}"\ntimeout_ms = 30_000'
            places = [f"register = 0\nunit = {address}" for address in units]
            readings, errors = await take_across_sessions(source_in({}, source, places, 4.0), 8)
    assert errors == []
    whole = [one for one in readings if None not in one.counts]
    for reading in whole:
        for unit, count in zip(units.values(), reading.counts, strict=True):
            assert count is not None
            assert unit.age_s(count, reading.monotonic_s) < EXACT_S
    # They do not come together: the last value is younger than the reading says.
    assert whole
    assert all(units[3].age_s(one.counts[2] or 0.0, one.monotonic_s) < -LATE_S for one in whole)


async def test_requests_to_one_unit_follow_each_other() -> None:
    unit = late()
    async with tcp_unit(unit) as port:
        source = f'kind = "modbus-tcp"\nhost = "127.0.0.1"\nport = {port}\ntimeout_ms = 30_000'
        places = [f"register = {register}" for register in APART]
        readings, errors = await take_across_sessions(source_in({}, source, places, 4.0), 8)
    assert errors == []
    for reading in readings:
        ages_s = [unit.age_s(count or 0.0, reading.monotonic_s) for count in reading.counts]
        assert max(ages_s) < EXACT_S
        assert ages_s[-1] < -LATE_S
