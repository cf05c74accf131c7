"""MicroPython's `machine` for a board that is not there: pins, an ADC, and ADS1115 chips on an I2C bus.

The environment names a file with the voltages of the inputs, in channel order, and one that notes what the LED does. It
may state the noise of a conversion.
The chips follow the data sheet of the ADS1115. A negative voltage is a chip that does not answer.
"""

import os
import random
import time

FULL_SCALE_V = 3.3
CHIP_FULL_SCALE_V = {0: 6.144, 1: 4.096, 2: 2.048, 3: 1.024, 4: 0.512, 5: 0.256}
"""By the bits of the gain."""
CHIP_RATES_HZ = (8, 16, 32, 64, 128, 250, 475, 860)
FIRST_CHIP = 0x48


def voltages() -> list[float]:
    """Return the voltages of all inputs."""
    with open(os.getenv("VOLTAGES") or "") as file:  # noqa: PTH123 - MicroPython has no pathlib
        return [float(word) for word in file.read().split()]


def noise_v() -> float:
    """Return the noise of a conversion: nearly normal, as a sum of twelve."""
    return float(os.getenv("NOISE_V") or 0) * (sum([random.random() for _ in range(12)]) - 6)  # noqa: S311


class Pin:
    OUT = 1

    def __init__(self, name: object, _mode: int = 0) -> None:
        self.name, self._value = name, 0

    def value(self, value: int) -> None:
        """Note a change of the LED."""
        if value != self._value:
            self._value = value
            with open(os.getenv("LIGHT") or "", "a") as file:  # noqa: PTH123
                file.write(f"{value}\n")


class ADC:
    def __init__(self, pin: Pin) -> None:
        assert isinstance(pin.name, int)
        self._channel = pin.name - 26  # as on a Pico

    def read_u16(self) -> int:
        """Convert to 12 bits, and stretch them to 16 as MicroPython does."""
        raw = min(4095, int((voltages()[self._channel] + noise_v()) / FULL_SCALE_V * 4096))
        return raw << 4 | raw >> 8


class I2C:
    def __init__(self, _number: int, **wiring: object) -> None:
        assert sorted(wiring) == ["freq", "scl", "sda"]
        self._chips: dict[int, Ads1115] = {}

    def writeto_mem(self, address: int, register: int, data: bytes) -> None:
        """Write a register of a chip."""
        self._chip(address).write(register, data[0] << 8 | data[1])

    def readfrom_mem_into(self, address: int, register: int, data: bytearray) -> None:
        """Read a register of a chip."""
        word = self._chip(address).read(register) & 0xFFFF
        data[0], data[1] = word >> 8, word & 0xFF

    def _chip(self, address: int) -> "Ads1115":
        first = 4 * (address - FIRST_CHIP)
        inputs = voltages()[first : first + 4]
        if not inputs or inputs[0] < 0:
            raise OSError(19)
        chip = self._chips.setdefault(address, Ads1115())
        chip.inputs = inputs
        return chip


class Ads1115:
    def __init__(self) -> None:
        self.inputs: list[float] = []
        self._configuration = 0x8583  # at power-on
        self._ready_s = 0.0
        self._next = self._result = 0

    def write(self, register: int, word: int) -> None:
        assert register == 1
        self._configuration = word
        if not word & 0x8000:
            return
        assert word & 0x0100, "it would convert again and again"
        mux, gain, rate = word >> 12 & 7, word >> 9 & 7, word >> 5 & 7
        assert mux >= 4, "between two inputs"
        self._next = min(32767, int((self.inputs[mux - 4] + noise_v()) / CHIP_FULL_SCALE_V[gain] * 32768))
        self._ready_s = time.time() + 1 / CHIP_RATES_HZ[rate]

    def read(self, register: int) -> int:
        is_ready = time.time() >= self._ready_s
        if is_ready:
            self._result = self._next
        return self._result if register == 0 else self._configuration & 0x7FFF | is_ready << 15


def reset() -> None:
    """End the program: there is nothing to start anew."""
    raise SystemExit(3)
