"""The C codec on the chip of the reference firmware: small, and of use to a sketch in C++."""

from pathlib import Path

import pytest

from toolchain import CODEC, need, run

MOST_FLASH_BYTES = 2048
WARNINGS = ("-Wall", "-Wextra", "-Werror", "-pedantic")
HOST: tuple[str, ...] = ()
DEVICE = ("-DBEAMTOUCH_MOST_FRAME_BYTES=10", "-DBEAMTOUCH_MOST_CHANNELS=8")


@pytest.mark.parametrize("defines", [HOST, DEVICE])
def test_it_takes_less_than_2_kb_of_flash_with_all_messages_of_both_sides(
    tmp_path: Path, defines: tuple[str, ...]
) -> None:
    need("avr-gcc", "avr-size")
    target = tmp_path / "codec.o"
    source = CODEC / "beamtouch_protocol.c"
    run("avr-gcc", "-std=c99", *WARNINGS, "-Os", "-mmcu=atmega328p", *defines, "-c", source, "-o", target)
    text, data, bss = map(int, run("avr-size", target).splitlines()[1].split()[:3])
    assert text + data < MOST_FLASH_BYTES
    assert data + bss == 0


def test_cpp_can_include_it(tmp_path: Path) -> None:
    """A sketch for an Arduino is C++."""
    need("avr-g++")
    sketch = tmp_path / "sketch.cpp"
    sketch.write_text(
        '#include "beamtouch_protocol.h"\nbeamtouch_decoder decoder;\n'
        "bool take(uint8_t byte, beamtouch_message &m) { return beamtouch_decode(&decoder, byte, &m); }\n"
    )
    target = tmp_path / "sketch.o"
    run("avr-g++", "-Wall", "-Wextra", "-Werror", "-mmcu=atmega328p", f"-I{CODEC}", "-c", sketch, "-o", target)
    assert " U beamtouch_decode\n" in run("avr-nm", target)
