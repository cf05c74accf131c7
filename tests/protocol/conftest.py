"""Messages with any values that the wire can carry, for `st.from_type`; simulated boards."""

import pytest
from hypothesis import strategies as st

from beamtouch_protocol.messages import Hello, Identify, Ping, Pong, Reading, Start

from .simulated_board import Board, Boards, build_board, build_firmware
from .toolchain import made_once

u8 = st.integers(0, 2**8 - 1)
u16 = st.integers(0, 2**16 - 1)
u32 = st.integers(0, 2**32 - 1)
counts = st.lists(st.just(0) | u16, min_size=1, max_size=32).map(tuple)

st.register_type_strategy(Start, st.builds(Start, rate_hz=u16, oversampling=u8))
st.register_type_strategy(Ping, st.builds(Ping, token=u16))
st.register_type_strategy(Pong, st.builds(Pong, token=u16, device_us=u32))
st.register_type_strategy(Identify, st.builds(Identify, seconds=u8))
st.register_type_strategy(Reading, st.builds(Reading, sequence=u16, device_us=u32, oversampling=u8, counts=counts))
st.register_type_strategy(
    Hello,
    st.builds(Hello, protocol_version=u8, schema_hash=u32, boot_id=u32, channel_count=u8, adc_bits=u8, max_rate_hz=u16),
)


@pytest.fixture(scope="session")
def board_for(tmp_path_factory: pytest.TempPathFactory) -> Boards:
    """A function from a number of channels to a board with a firmware for it; each is built once."""

    def board(channels: int, more: str = "") -> Board:
        program = made_once(tmp_path_factory, "board", build_board) / "board"
        name = f"firmware-{channels}{more}"
        folder = made_once(tmp_path_factory, name, lambda folder: build_firmware(folder, channels, more))
        return Board(program, folder / "firmware.elf")

    return board


@pytest.fixture(scope="session")
def board(board_for: Boards) -> Board:
    """A board with four channels."""
    return board_for(4)
