"""The C codec compiled for the reference firmware's chip: its size, and its use from C++."""

from pathlib import Path

import pytest

from toolchain import CODEC, need, run

MAX_FLASH_BYTES = 2048
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-pedantic")
HOST: tuple[str, ...] = ()
DEVICE = ("-DBEAMTOUCH_MAX_FRAME_BYTES=10", "-DBEAMTOUCH_MAX_CHANNELS=8")


@pytest.mark.parametrize("defines", [HOST, DEVICE])
def test_the_codec_with_all_messages_takes_less_than_2_kb_of_flash(tmp_path: Path, defines: tuple[str, ...]) -> None:
    need("avr-gcc", "avr-size")
    target = tmp_path / "codec.o"
    source = CODEC / "beamtouch_protocol.c"
    run("avr-gcc", "-std=c99", *WARNINGS, "-Os", "-mmcu=atmega328p", *defines, "-c", source, "-o", target)
    text, data, bss = map(int, run("avr-size", target).splitlines()[1].split()[:3])
    assert text + data < MAX_FLASH_BYTES
    assert data + bss == 0


def test_an_arduino_sketch_in_cpp_can_include_the_codec(tmp_path: Path) -> None:
    need("avr-g++")
    sketch = tmp_path / "sketch.cpp"
    sketch.write_text(
        '#include "beamtouch_protocol.h"\nbeamtouch_decoder decoder;\n'
        "bool take(uint8_t byte, beamtouch_message &m) { return beamtouch_decode(&decoder, byte, &m); }\n"
    )
    target = tmp_path / "sketch.o"
    run("avr-g++", "-Wall", "-Wextra", "-Werror", "-mmcu=atmega328p", f"-I{CODEC}", "-c", sketch, "-o", target)
    assert " U beamtouch_decode\n" in run("avr-nm", target)
