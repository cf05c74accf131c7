"""The Modbus TCP servers of two services that share their surfaces."""

from __future__ import annotations

import itertools
import math
import struct
from typing import TYPE_CHECKING

import pytest

from beamtouch_service.outputs.modbus.registers import REGISTERS, STATES
from beamtouch_service.problems import Kind
from service.conftest import batch_of
from waiting import wait_until

from .modbus_service import ModbusService, start_modbus

if TYPE_CHECKING:
    from pathlib import Path

    from .conftest import StartService

OFFSETS = {one.name: one.offset for one in REGISTERS}
FIGURES = [OFFSETS[name] for name in ("position_mm", "position_low_mm", "position_high_mm", "force_n")]
CONTACT = 2

pytestmark = pytest.mark.usefixtures("token_file")


def state(service: ModbusService) -> int:
    """Return the state of the block; without a contact, all its figures must be NaN."""
    words = service.registers()
    found = words[OFFSETS["state"]]
    if found != CONTACT:
        figures = [struct.unpack(">f", struct.pack(">2H", *words[offset : offset + 2]))[0] for offset in FIGURES]
        assert all(math.isnan(figure) for figure in figures), words
    return found


def test_a_block_without_samples_in_this_service_has_no_figures(
    start_service: StartService, tmp_path: Path, events_url: str
) -> None:
    events = f"[events]\nurl = '{events_url}'"
    one, other = (
        start_modbus(start_service, tmp_path, events, stale_ms=2000, server="replica = true") for _ in range(2)
    )
    no_samples, stale = STATES[Kind.NO_SAMPLES][0], STATES[Kind.STALE][0]
    assert (state(one), state(other)) == (no_samples, no_samples)
    assert one.http.post(batch_of(sequence=1)).status_code == 200
    assert state(other) == no_samples

    # The surface moves to the other service. The first one knows only what it had, until that is too old.
    assert other.http.post(batch_of(sequence=2)).status_code == 200
    wait_until(lambda: state(one) == stale)
    sequence = itertools.count(3)
    wait_until(lambda: other.http.post(batch_of(sequence=next(sequence))).is_success and state(other) == CONTACT)
    assert state(one) == stale
