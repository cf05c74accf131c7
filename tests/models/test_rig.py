"""The virtual surface: scripts, sensor characteristic, imperfections, and the device on a pseudo-terminal."""

import asyncio
import contextlib
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from beamtouch_common.errors import InputError
from beamtouch_models.errors import SceneError
from beamtouch_models.metadata import Departures, Sensor
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.physics.beam import influence
from beamtouch_models.rig.faults import Faults
from beamtouch_models.rig.imperfections import Imperfections, load_imperfections
from beamtouch_models.rig.pty_line import joined_line, named_line
from beamtouch_models.rig.relay import Relay
from beamtouch_models.rig.script import Load, Script, default_script, load_script
from beamtouch_models.rig.serial_device import MAX_RATE_HZ, SerialDevice
from beamtouch_models.rig.surface import VirtualSurface, counts_of_gap
from beamtouch_models.scene import change_scene, load_scene
from beamtouch_models.scene.beam import Beam
from beamtouch_protocol.framing import Decoder, encode
from beamtouch_protocol.messages import Hello, HelloRequest, Message, Ping, Pong, Reading, Start, Stop
from example_scenes import SCENES
from in_process import Command

scene, _ = load_scene(SCENES / "bench.toml")

UNTROUBLED = Relay(Faults([]), time.monotonic)

READINGS = 1500
"""Enough for the mean of a channel to 3 % of its noise, and for the noise to 2 %."""

TOUCH_MOVE_LIFT = """
repeat = false
[[step]]
seconds = 1
[[step]]
seconds = 2
position_mm = 100
force_n = 10
[[step]]
seconds = 4
position_mm = [100, 300]
force_n = [10, 20]
"""


def script_of(tmp_path: Path, text: str) -> Script:
    (tmp_path / "script.toml").write_text(text)
    return load_script(tmp_path / "script.toml", 400.0)


def test_a_load_touches_moves_and_lifts(tmp_path: Path) -> None:
    script = script_of(tmp_path, TOUCH_MOVE_LIFT)
    assert script.at(0.5) == Load(None, 0.0)
    assert script.at(1.0) == Load(100, 10)
    assert script.at(5.0) == Load(200, 15)
    assert script.at(7.0) == Load(None, 0.0)
    assert script.at(1e9) == Load(None, 0.0)


def test_a_script_repeats_unless_told_otherwise(tmp_path: Path) -> None:
    script = script_of(tmp_path, TOUCH_MOVE_LIFT.replace("repeat = false", ""))
    assert script.at(7.0 + 5.0) == Load(200, 15)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[[step]]\nseconds = 0", "seconds"),
        ("[[step]]\nseconds = 1\nposition_mm = 3", "together"),
        ("[[step]]\nseconds = 1\nposition_mm = 401\nforce_n = 1", "must lie on the beam"),
        ("[[step]]\nseconds = 1\nspeed = 3", "speed"),
        ("", "step"),
        ("[[", "not valid TOML"),
        ("x = " + "[" * 100_000, "not valid TOML"),
    ],
)
def test_a_bad_script_is_refused(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        script_of(tmp_path, text)


def test_the_default_script_stays_in_the_range_of_the_scene() -> None:
    script = default_script(scene)
    loads = [script.at(time) for time in np.arange(0, 19, 0.01)]
    touching = [load for load in loads if load.position_mm is not None]
    assert 0.6 < len(touching) / len(loads) < 0.95
    assert all(1 <= (load.position_mm or 0) <= 399 and 2 <= load.force_n <= 20 for load in touching)


def sensor_of(bits: int) -> Sensor:
    """Linear from 1 to 4 mm over the middle 80 % of the scale, worked out by hand."""
    full_scale = 2**bits - 1
    gain = 3 / (0.8 * full_scale)
    return Sensor(
        rate_hz=100, range_mm=(1, 4), standoff_mm=3.5, adc_bits=bits, gain_mm_per_count=gain, offset_mm=1 - 0.375
    )


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_the_characteristic_is_linear_from_1_to_4_mm_and_levels_off_beyond(bits: int) -> None:
    sensor, full_scale = sensor_of(bits), 2**bits - 1
    gap = np.linspace(1, 4, 1001)
    linear = 0.1 + 0.8 * (gap - 1) / 3
    assert np.abs(counts_of_gap(sensor, gap) - linear * full_scale).max() <= 0.5 + 1e-6
    assert counts_of_gap(sensor, np.array([-1e6, 1e6])).tolist() == [0, full_scale]
    beyond = counts_of_gap(sensor, np.array([0.8, 4.2])) / full_scale
    assert 0 < beyond[0] < 0.1
    assert 0.9 < beyond[1] < 1


def test_counts_come_back_as_the_deflection_with_the_noise_of_the_scene(bench: ModelFile) -> None:
    surface = VirtualSurface(scene, bench.metadata, seed=1)
    sensor = bench.metadata.sensor
    counts = np.array([surface.counts(Load(150.0, 12.0), 0.0) for _ in range(READINGS)])
    deflection = sensor.standoff_mm - (sensor.offset_mm + sensor.gain_mm_per_count * counts)
    expected = 12.0 * influence(scene.beam, [68, 156, 244, 332], [150.0])[0]
    noise = 0.002 * bench.metadata.max_deflection_mm
    assert deflection.mean(axis=0) == pytest.approx(expected, abs=5 * noise / np.sqrt(READINGS))
    assert deflection.std(axis=0) == pytest.approx(np.full(4, noise), rel=0.06)
    assert VirtualSurface(scene, bench.metadata, seed=1).counts(Load(150.0, 12.0), 0.0) == counts[0].tolist()


def includes(kind: type[Message], messages: list[Message]) -> bool:
    return any(isinstance(message, kind) for message in messages)


Sent = list[Message | float | type[Message]]
"""What a host sends; a number is a pause [s], and for a message of a type is waited."""


async def exchange(path: Path, sent: Sent, enough: Callable[[list[Message]], bool]) -> list[Message]:
    """Talk to a serial device as a host would and return its messages."""
    received: list[Message] = []
    with named_line(path) as line:
        device = asyncio.create_task(SerialDevice(line, lambda: [1, 2, 65535], 3, 16, UNTROUBLED).serve())
        await asyncio.sleep(0)
        host = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            decoder = Decoder()

            async def until(holds: Callable[[list[Message]], bool]) -> None:
                nonlocal received
                async with asyncio.timeout(60):
                    while not holds(received):
                        received += decoder.feed(await asyncio.to_thread(os.read, host, 4096))

            for message in sent:
                if isinstance(message, float):
                    await asyncio.sleep(message)
                elif isinstance(message, type):
                    await until(partial(includes, message))
                else:
                    await asyncio.to_thread(os.write, host, encode(message))
            await until(enough)
        finally:
            os.close(host)
            device.cancel()
            await asyncio.wait([device])
    return received


@pytest.mark.anyio
async def test_the_serial_device_says_hello_and_streams_until_stopped(tmp_path: Path) -> None:
    received = await exchange(tmp_path / "line", [HelloRequest(), Start(500, 1)], lambda so_far: len(so_far) >= 52)
    hellos = [message for message in received if isinstance(message, Hello)]
    readings = [message for message in received if isinstance(message, Reading)]
    assert len(hellos) == 2
    assert hellos[0] == hellos[1]
    assert (hellos[0].channel_count, hellos[0].adc_bits, hellos[0].is_compatible) == (3, 16, True)
    numbers = [reading.sequence for reading in readings]
    assert numbers[0] == 0
    assert numbers == sorted(set(numbers))  # a scan that a busy machine skips has a number too
    assert all(reading.counts == (1, 2, 65535) for reading in readings)
    clocks = [reading.device_us for reading in readings]
    assert clocks == sorted(clocks)
    # A busy machine skips slots and is late for others, but never catches up.
    assert clocks[-1] - clocks[0] >= (len(readings) - 3) * 2000
    assert np.diff(clocks).min() < 2600


@pytest.mark.anyio
async def test_a_stopped_device_sends_nothing_but_answers(tmp_path: Path) -> None:
    script: list[Message | float | type[Message]] = [
        Start(500, 1),
        Reading,
        Stop(),
        HelloRequest(),
        0.1,
        HelloRequest(),
    ]
    received = await exchange(tmp_path / "line", script, lambda so_far: sum(isinstance(m, Hello) for m in so_far) == 3)
    kinds = [type(message) for message in received]
    assert kinds[-2:] == [Hello, Hello]  # after the stop, the device sent only answers


@pytest.mark.anyio
async def test_it_answers_a_ping_and_ignores_what_a_device_does_not_take(tmp_path: Path) -> None:
    script: Sent = [Pong(6, 0), Start(MAX_RATE_HZ + 1, 1), Start(500, 2), Ping(7)]
    received = await exchange(tmp_path / "line", script, lambda so_far: any(isinstance(m, Pong) for m in so_far))
    assert [type(message) for message in received] == [Hello, Pong]
    assert isinstance(received[1], Pong)
    assert received[1].token == 7


@pytest.mark.anyio
async def test_frames_on_a_line_that_nobody_reads_are_lost_and_the_device_goes_on(tmp_path: Path) -> None:
    converted = [0]

    def convert() -> list[int]:
        converted[0] += 1
        return [1] * 8

    with named_line(tmp_path / "line") as line:
        host = os.open(tmp_path / "line", os.O_RDWR | os.O_NOCTTY)
        os.set_blocking(host, False)
        device = asyncio.create_task(SerialDevice(line, convert, 8, 16, UNTROUBLED).serve())
        os.write(host, encode(Start(MAX_RATE_HZ, 1)))
        try:
            async with asyncio.timeout(60):
                while converted[0] < 3000:  # noqa: ASYNC110  # more than a pseudo-terminal holds
                    await asyncio.sleep(0.01)
                decoder, sequences = Decoder(), list[int]()
                while not sequences or sequences[-1] < 3000:
                    with contextlib.suppress(BlockingIOError):
                        found = decoder.feed(os.read(host, 4096))
                        sequences += [message.sequence for message in found if isinstance(message, Reading)]
                    await asyncio.sleep(0.001)
        finally:
            os.close(host)
            device.cancel()
            await asyncio.wait([device])
    assert len(sequences) < sequences[-1]


def test_a_line_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    with (
        pytest.raises(SceneError, match=r"absent/line: No such file or directory"),
        named_line(tmp_path / "absent/line"),
    ):
        pass
    (tmp_path / "line").symlink_to(tmp_path / "gone")  # left behind by a rig that was killed
    with named_line(tmp_path / "line"):
        assert (tmp_path / "line").is_char_device()


@pytest.mark.anyio
async def test_a_joined_line_that_nobody_reads_loses_bytes_and_works_again(tmp_path: Path) -> None:
    with joined_line(tmp_path / "line", UNTROUBLED) as near_name:
        near, far = (os.open(name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK) for name in (near_name, tmp_path / "line"))
        try:
            for _ in range(100):
                with contextlib.suppress(BlockingIOError):
                    os.write(near, bytes(1000))
                await asyncio.sleep(0)
            async with asyncio.timeout(60):
                held = b""
                while b"again" not in held:
                    with contextlib.suppress(BlockingIOError):
                        os.write(near, b"again")
                    await asyncio.sleep(0.01)
                    with contextlib.suppress(BlockingIOError):
                        held += os.read(far, 65_536)
        finally:
            os.close(near)
            os.close(far)
    assert held.count(0) < 100_000


def test_a_line_removes_its_link_and_never_replaces_a_file(tmp_path: Path) -> None:
    with named_line(tmp_path / "line"):
        assert (tmp_path / "line").is_char_device()
    assert not (tmp_path / "line").is_symlink()
    (tmp_path / "file").write_text("keep me")
    with pytest.raises(SceneError, match="exists already"), named_line(tmp_path / "file"):
        pass
    assert (tmp_path / "file").read_text() == "keep me"


@pytest.mark.anyio
async def test_a_joined_line_carries_bytes_both_ways(tmp_path: Path) -> None:
    with joined_line(tmp_path / "line", UNTROUBLED) as near_name:
        ends = [os.open(name, os.O_RDWR | os.O_NOCTTY) for name in (near_name, tmp_path / "line")]
        for one, other in (ends, ends[::-1]):
            await asyncio.to_thread(os.write, one, b"\x00\x11\x13\x03\r\n")
            async with asyncio.timeout(60):
                assert await asyncio.to_thread(os.read, other, 100) == b"\x00\x11\x13\x03\r\n"
        for end in ends:
            os.close(end)


IMPERFECT = """
position_offset_mm = [1.0, -1.0, 0.5, 0.0]
gain = [1.03, 0.97, 1.0, 1.01]
offset_mm = [0.01, 0.0, -0.02, 0.0]
curve_per_mm = 0.02
fixity = [0.05, 0.0]
rigidity = 1.1
"""


def test_imperfections_change_the_counts_as_stated(bench: ModelFile, tmp_path: Path) -> None:
    path = tmp_path / "imperfections.toml"
    path.write_text(IMPERFECT)
    surface = VirtualSurface(scene, bench.metadata, 1, load_imperfections(path))
    sensor, layout = bench.metadata.sensor, np.array([c.position_mm for c in bench.metadata.layout])
    counts = np.mean([surface.counts(Load(150.0, 12.0), 0.0) for _ in range(READINGS)], axis=0)
    ends = [{"at_mm": 0.0, "fixity": 0.05}, {"at_mm": 400.0}]
    stiffer = {**scene.beam.model_dump(), "youngs_modulus_gpa": 231.0, "supports": ends}
    deflection = 12 * influence(Beam.model_validate(stiffer), layout + np.array([1, -1, 0.5, 0]), [150.0])[0]
    linear = np.array([1.03, 0.97, 1.0, 1.01]) * deflection
    seen = (np.sqrt(1 + 4 * 0.02 * linear) - 1) / (2 * 0.02)
    gap = sensor.standoff_mm - seen + [0.01, 0, -0.02, 0]
    assert sensor.offset_mm + sensor.gain_mm_per_count * counts == pytest.approx(gap, abs=5e-4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("gain = [1.0]", "gain has 1 entries for 4 channels"),
        ("gian = [1, 1, 1, 1]", "unknown key gian"),
        ("fixity = [1.0, 0.0]", "fixity"),
        ("rigidity = 0", "rigidity"),
        ("damping_ratio = 1", "damping_ratio"),
        ("position_offset_mm = [-200, 0, 0, 0]", "moves a sensor off the beam"),
        ("gain = [", "imperfections.toml"),
    ],
)
def test_wrong_imperfections_are_one_line(
    rig_here: Command, bench_model: Path, tmp_path: Path, text: str, said: str
) -> None:
    path = tmp_path / "imperfections.toml"
    path.write_text(text)
    line = ("--modbus-tcp", "127.0.0.1:0")
    done = rig_here(SCENES / "bench.toml", "--model", bench_model, *line, "--imperfections", path)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert said in done.stderr


def test_a_fixed_support_takes_no_fixity(bench: ModelFile) -> None:
    propped = change_scene(scene, beam={"supports": "propped"})
    with pytest.raises(SceneError, match="already fixed"):
        VirtualSurface(propped, bench.metadata, 1, Imperfections(fixity=(0.1, 0.0)))


def test_loads_are_put_on_by_hand(bench_model: Path) -> None:
    program = Path(sys.executable).parent / "beamtouch-rig"
    command: list[str | Path] = [program, SCENES / "bench.toml", "--model", bench_model]
    with subprocess.Popen(
        [*command, "--by-hand", "--modbus-tcp", "127.0.0.1:0"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONIOENCODING": "utf-8:strict"},  # as with LANG=en_US.UTF-8
    ) as process:
        try:
            assert process.stdin is not None
            assert process.stdout is not None
            assert process.stderr is not None
            assert process.stdout.readline().startswith("listening on modbus-tcp ")
            process.stdin.write("150 10\nabc\n9999 10\n\n")
            process.stdin.flush()
            assert process.stdout.readline() == "10 N at 150 mm is on\n"
            assert process.stderr.readline().startswith("beamtouch-rig: give a position in mm and a force in N")
            assert process.stderr.readline() == "beamtouch-rig: 10 N at 9999 mm is no load on a beam of 400 mm\n"
            assert process.stdout.readline() == "nothing is on\n"
            os.write(process.stdin.fileno(), b"150\xa0mm 10\n150 12\n")
            assert process.stdout.readline() == "12 N at 150 mm is on\n"
        finally:
            process.terminate()


def test_a_client_that_goes_before_its_answer_leaves_no_word(bench_model: Path) -> None:
    program = Path(sys.executable).parent / "beamtouch-rig"
    command: list[str | Path] = [program, SCENES / "bench.toml", "--model", bench_model, "--modbus-tcp", "127.0.0.1:0"]
    ask = struct.pack(">HHHBBHH", 1, 0, 6, 1, 4, 0, 4)
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            port = int(process.stdout.readline().rpartition(":")[2])
            for _ in range(50):
                with socket.create_connection(("127.0.0.1", port), 60) as client:
                    client.sendall(ask)
            with socket.create_connection(("127.0.0.1", port), 60) as client:
                client.sendall(ask)
                assert client.recv(100)
        finally:
            process.terminate()
            said = process.communicate(timeout=60)[1]
    assert said == ""


def test_departures_undo_what_they_do() -> None:
    rng = np.random.default_rng(3)
    stated = {"gain": [0.95, 1.0, 1.04], "offset_mm": [0.02, -0.03, 0.0], "curve_per_mm": 0.03}
    departures = Departures.none(3).model_copy(update=stated)
    linear = rng.uniform(-1.0, 3.0, (50, 3))

    measured = departures.measure(linear)

    # As its line says: y + curve y^2 is the deflection with its gain, and y is measured without the offset.
    y = measured - np.array([0.02, -0.03, 0.0])
    assert y + 0.03 * y**2 == pytest.approx(linear, abs=1e-12)
    assert departures.linear_mm(measured) == pytest.approx(linear, abs=1e-12)
