"""The reference firmware follows PROTOCOL.md, on a simulated chip. All times are simulated time."""

import random
from pathlib import Path

import pytest

from beamtouch_protocol.framing import encode
from beamtouch_protocol.messages import Hello, HelloRequest, Identify, Message, Ping, Pong, Reading, Start, Stop
from support.programs.simulated_board import Board, Boards, at, count_of

VOLTAGES = (1000, 2000, 3000, 4000, 500, 0, 5000, 4500)
CHANNELS = (1, 8)


def assert_counts(reading: Reading, millivolts: tuple[int, ...]) -> None:
    assert len(reading.counts) == len(millivolts)
    for count, voltage in zip(reading.counts, millivolts, strict=True):
        assert abs(count - reading.oversampling * count_of(voltage)) <= 2 * reading.oversampling


def test_readings_hold_sums_of_the_voltages_in_order_without_gaps_at_the_rate(board: Board, tmp_path: Path) -> None:
    later = (4000, 3000, 2000, 1000)
    script = [at(0, VOLTAGES), at(0.1, Start(200, 1)), at(1.2, Start(200, 16)), at(1.4, later), at(1.5, Start(100, 64))]
    seen = board.record(tmp_path, 1.7, *script)
    first = [reading for reading in seen.readings if reading.oversampling == 1]
    assert [reading.sequence for reading in seen.readings] == list(range(len(seen.readings)))
    assert 218 <= len(first) <= 221
    steps = seen.steps_us[: len(first) - 1]
    assert all(abs(step - 5000) <= 30 for step in steps)
    assert sum(steps) == pytest.approx(5000 * len(steps), abs=30)
    assert {reading.oversampling for reading in seen.readings} == {1, 16, 64}
    for reading in [*first, seen.readings[len(first) + 10]]:
        assert_counts(reading, VOLTAGES[:4])
    assert_counts(seen.readings[-1], later)


def test_a_reading_has_the_time_of_the_middle_of_its_scan(board: Board, tmp_path: Path) -> None:
    """A voltage step during a long scan splits each channel's sum in proportion to the times before and after it."""
    scan_us = 64 * 4 * 28
    seen = board.record(tmp_path, 0.5, at(0, (0, 0, 0, 0)), at(0.1, Start(100, 64)), at(0.3025, (5000,) * 4 + (0,)))
    pinged = board.record(tmp_path, 0.5, at(0.3025, Ping(1)))
    step_us = pinged.pongs[0].device_us
    halved = [reading for reading in seen.readings if 0 < sum(reading.counts) < 4 * 64 * 1020]
    assert halved
    for reading in halved:
        share_after = sum(reading.counts) / (4 * 64 * 1023)
        assert step_us - reading.device_us == pytest.approx((0.5 - share_after) * scan_us, abs=500)
    full = [reading for reading in seen.readings if reading not in halved]
    assert all((reading.device_us > step_us) == (reading.counts[0] > 0) for reading in full)


def test_stop_ends_the_readings_and_start_continues_their_numbers(board: Board, tmp_path: Path) -> None:
    script = [at(0.1, Start(200, 1)), at(0.2, Stop()), at(0.4, Start(200, 1)), at(0.5, Stop())]
    seen = board.record(tmp_path, 0.8, *script)
    assert 38 <= len(seen.readings) <= 42
    assert seen.lost == 0
    assert len([step for step in seen.steps_us if step > 100_000]) == 1


def test_a_start_during_a_stream_changes_it_without_a_gap(board: Board, tmp_path: Path) -> None:
    seen = board.record(tmp_path, 0.5, *(at(0.1 + 0.0137 * n, Start(500 + 100 * n, 1 + n % 3)) for n in range(12)))
    assert seen.lost == 0
    assert {reading.oversampling for reading in seen.readings} == {1, 2, 3}


@pytest.mark.parametrize(("channels", "rate_hz", "oversampling"), [(4, 7, 1), (4, 3001, 1), (1, 5625, 4), (8, 60, 64)])
def test_any_rate_is_kept_in_the_long_run_with_any_oversampling(
    board_for: Boards, tmp_path: Path, channels: int, rate_hz: int, oversampling: int
) -> None:
    seen = board_for(channels).record(tmp_path, 1.1, at(0.05, Start(rate_hz, oversampling)))
    assert seen.lost == 0
    assert sum(seen.steps_us) / len(seen.steps_us) == pytest.approx(1e6 / rate_hz, rel=1e-4)


REFUSED = [Start(0, 1), Start(100, 0), Start(4091, 1), Start(65535, 1), Start(100, 65), Start(100, 255), Start(122, 64)]


def test_a_start_that_the_device_cannot_keep_is_ignored_at_rest_and_in_a_stream(board: Board, tmp_path: Path) -> None:
    def refused(begin_s: float) -> list[str]:
        return [at(begin_s + 0.05 * n, start) for n, start in enumerate(REFUSED)]

    script = [*refused(0.1), at(0.6, Start(121, 64)), at(0.7, Start(200, 2)), *refused(0.8)]
    seen = board.record(tmp_path, 1.3, *script)
    assert seen.readings[0].device_us > 590_000
    assert {reading.oversampling for reading in seen.readings} == {64, 2}
    assert seen.lost == 0
    steps = seen.steps_us[-100:]
    assert all(abs(step - 5000) <= 30 for step in steps)


def test_every_ping_gets_its_pong_with_the_clock(board: Board, tmp_path: Path) -> None:
    tokens = [0, 1, 513, 65535]
    pings = [at(0.1 + 0.1 * n, Ping(token)) for n, token in enumerate(tokens)]
    seen = board.record(tmp_path, 0.6, *pings, at(0.55, encode(Ping(1)) + encode(HelloRequest()) + encode(Ping(2))))
    assert [pong.token for pong in seen.pongs] == [*tokens, 1, 2]
    for n, pong in enumerate(seen.pongs[: len(tokens)]):
        assert pong.device_us - seen.pongs[0].device_us == pytest.approx(100_000 * n, abs=2000)
    assert [type(message) for message in seen.messages[-3:]] == [Pong, Hello, Pong]


@pytest.mark.parametrize("channels", CHANNELS)
def test_hello_states_a_highest_rate_at_which_nothing_is_lost_while_the_device_answers(
    board_for: Boards, tmp_path: Path, channels: int
) -> None:
    rate_hz = 90_000 // (14 + 2 * channels)  # nine tenths of the line
    burst = encode(Ping(1)) + encode(HelloRequest()) + encode(Ping(2))
    bursts = [at(0.2 + 0.05 * n, burst) for n in range(20)]
    script = [at(0, VOLTAGES), at(0.1, Start(rate_hz, 1)), *bursts, at(2.1, Stop())]
    seen = board_for(channels).record(tmp_path, 2.2, *script)
    assert (seen.lost, seen.rejected) == (0, 0)
    assert len(seen.readings) == pytest.approx(2 * rate_hz, abs=0.002 * rate_hz + 2)  # commands act within 1 ms
    assert sum(seen.steps_us) / len(seen.steps_us) == pytest.approx(1e6 / rate_hz, rel=1e-4)
    assert (len(seen.pongs), len(seen.hellos)) == (40, 21)
    (hello,) = set(seen.hellos)  # at boot and on request
    assert hello.is_compatible
    assert (hello.channel_count, hello.adc_bits, hello.max_rate_hz) == (channels, 10, rate_hz)
    assert seen.report["baud"] == 1_000_000
    for reading in seen.readings:
        assert_counts(reading, VOLTAGES[:channels])


def test_readings_for_which_the_line_has_no_room_take_their_numbers(board_for: Boards, tmp_path: Path) -> None:
    rate_hz, questions = 5625, b"".join(encode(Ping(token)) for token in range(5000))
    seen = board_for(1).record(tmp_path, 1.2, at(0.1, Start(rate_hz, 1)), at(0.2, questions))
    assert seen.lost > 100
    assert seen.rejected == 0
    taken = seen.readings[-1].sequence - seen.readings[0].sequence
    lasted_us = seen.readings[-1].device_us - seen.readings[0].device_us
    assert taken == pytest.approx(lasted_us * 1e-6 * rate_hz, abs=1)


@pytest.mark.parametrize("seconds", [2.0, pytest.param(12.0, marks=pytest.mark.soak)])
def test_the_clock_wraps_and_after_twelve_seconds_the_sequence(
    board_for: Boards, tmp_path: Path, seconds: float
) -> None:
    begin_us = 2**32 - 1_000_000
    board = board_for(1, f"-DCLOCK_BEGINS_US={begin_us}UL")
    seen = board.record(tmp_path, seconds, at(0.1, Start(5625, 1)))
    assert len(seen.readings) > (2**16 if seconds > 10 else 5625)
    assert seen.lost == 0
    assert seen.readings[0].device_us > begin_us
    assert all(abs(step - 1e6 / 5625) <= 30 for step in seen.steps_us)


def test_a_reset_shows_in_a_hello_with_another_boot_id(board: Board, tmp_path: Path) -> None:
    memory = ("--eeprom", tmp_path / "eeprom.bin")
    script = [at(0.1, Start(200, 1)), at(0.3, "reset"), at(0.4, Start(200, 1))]
    seen = board.record(tmp_path, 0.5, *script, options=memory)
    assert [reading.sequence for reading in seen.readings].count(0) == 2
    later = [board.record(tmp_path, 0.1, options=memory).hellos[0] for _ in range(3)]  # without power in between
    assert len({hello.boot_id for hello in [*seen.hellos, *later]}) == 5


def test_garbage_on_the_line_does_no_harm(board: Board, tmp_path: Path) -> None:
    generator = random.Random(6)  # noqa: S311 - noise, not secrets
    for_hosts: list[Message] = [Hello(1, 2, 3, 4, 5, 6), Pong(1, 2), Reading(1, 2, 3, (4,) * 32)]
    noise = generator.randbytes(3000) + b"".join(map(encode, for_hosts)) + encode(Stop())[:-2]
    garbage = tmp_path / "garbage.bin"
    garbage.write_bytes(noise)
    script = [at(0.1, Start(1000, 1)), at(0.2, noise), at(0.3, b"\0" + encode(Ping(7)))]
    seen = board.record(tmp_path, 0.4, *script, options=("--input", garbage))
    assert [pong.token for pong in seen.pongs] == [7]
    assert (len(seen.hellos), seen.lost, seen.rejected) == (1, 0, 0)


def test_a_flood_of_garbage_neither_stops_readings_nor_ends_in_a_reset(board: Board, tmp_path: Path) -> None:
    for byte in (b"\0", b"\x55"):
        flood = byte * (60_000 // len(byte))  # 0.6 s of the line
        seen = board.record(tmp_path, 0.9, at(0.1, Start(500, 1)), at(0.11, flood), at(0.8, b"\0" + encode(Ping(7))))
        assert [pong.token for pong in seen.pongs] == [7]
        assert (len(seen.hellos), seen.lost, seen.rejected) == (1, 0, 0)
        assert len(seen.readings) == pytest.approx(400, abs=3)


def test_identify_blinks_for_the_requested_time(board: Board, tmp_path: Path) -> None:
    def changes(seconds: float, *script: str) -> int:
        return board.record(tmp_path, seconds, *script).report["light_changes"]

    assert changes(0.5) == 0
    assert 6 <= changes(2.0, at(0.1, Identify(1))) <= 9
    # An even number of changes leaves the light off, as it was, whenever the end comes.
    stopped = [changes(1.5, at(0.1, Identify(2)), at(seconds, Identify(0))) for seconds in (0.4, 0.55, 0.7, 0.85)]
    assert [number % 2 for number in stopped] == [0, 0, 0, 0]
    assert 2 <= stopped[0] <= stopped[-1] <= 6
