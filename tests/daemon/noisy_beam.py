"""A beam behind a device on Modbus: two channels with noise."""

import numpy as np

from beamtouch_models.arrays import Floats

from .waits import until

REST, COUNTS_PER_UM, NOISE_COUNTS = 20_000, 10, 20


class NoisyBeam:
    """Answers for `pymodbus_server`, and counts how often it is asked."""

    def __init__(self, um: float = 0.0) -> None:
        """Begin with this deflection of both channels."""
        self.um: float | Floats = um
        """Deflection of each channel, or of both."""
        self.polls = 0
        self._noise = np.random.default_rng(5)

    async def answer(
        self, _function: int, _start: int, _address: int, _count: int, now: list[int], _set: object
    ) -> None:
        """Set the registers of both channels."""
        self.polls += 1
        counts = REST + COUNTS_PER_UM * self.um + self._noise.normal(scale=NOISE_COUNTS, size=2)
        now[:2] = [round(count) for count in counts.tolist()]

    async def asked(self, times: int) -> None:
        """Wait until it has been asked so many times more."""
        end = self.polls + times
        await until(lambda: self.polls >= end)
