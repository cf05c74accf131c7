"""What Modbus TCP and RTU share: polling the input registers of one unit, one request at a time, without retries.

A request that fails ends the session. Whoever opens the next one makes sure that the answer, should it still come, is
not taken for the answer to a later request; how, depends on the line.
"""

from abc import ABC, abstractmethod
from collections.abc import AsyncGenerator, Sequence
from dataclasses import dataclass
from time import monotonic

from pymodbus.client.base import ModbusBaseClient
from pymodbus.exceptions import ModbusException
from pymodbus.pdu import ModbusPDU

from beamtouch_daemon.sources.reading import Reading, Schedule, SourceError

MAX_REGISTERS = 125
"""The most that one request may ask for."""
READ_INPUT_REGISTERS = 4

_EXCEPTIONS = {
    1: "it does not know function 4",
    2: "it has no such input register",
    3: "it refuses that many registers",
    4: "device failure",
    6: "device busy",
    10: "gateway path unavailable",
    11: "gateway: the device does not answer",
}


@dataclass(frozen=True, slots=True)
class Block:
    """Registers in a row, read with one request."""

    first: int
    count: int


def blocks_of(registers: Sequence[int]) -> tuple[Block, ...]:
    """Return the fewest blocks that hold the registers and no other, each within the limit of one request."""
    blocks: list[Block] = []
    for register in sorted(set(registers)):
        last = blocks[-1] if blocks else None
        if last and register == last.first + last.count and last.count < MAX_REGISTERS:
            blocks[-1] = Block(last.first, last.count + 1)
        else:
            blocks.append(Block(register, 1))
    return tuple(blocks)


class ModbusSource(ABC):
    """Polls the input registers of one unit at a fixed rate."""

    def __init__(self, registers: Sequence[int], unit: int, rate_hz: float, timeout_s: float) -> None:
        self._registers = tuple(registers)
        self._blocks = blocks_of(registers)
        self._unit = unit
        self._rate_hz = rate_hz
        self._timeout_s = timeout_s

    @abstractmethod
    async def _connect(self) -> ModbusBaseClient:
        """Return a connected client on which no answer is outstanding; SourceError if that fails."""

    @abstractmethod
    async def _before_request(self) -> None:
        """Wait until the line may be used; SourceError if it is out of step."""

    async def readings(self) -> AsyncGenerator[list[Reading], None]:
        """Connect and yield one reading per slot of the schedule."""
        client = await self._connect()
        try:
            schedule = Schedule(self._rate_hz, monotonic())
            while True:
                missed = await schedule.wait()
                yield [await self._poll(client, missed)]
        finally:
            client.close()

    async def _poll(self, client: ModbusBaseClient, missed: int) -> Reading:
        """Read all blocks; the stamp is the midpoint between the first request and the last answer."""
        values: dict[int, int] = {}
        refusal = 0
        await self._before_request()
        begin_s = monotonic()
        for number, block in enumerate(self._blocks):
            if number:
                await self._before_request()
            answer = await self._request(client, block)
            if answer.isError():
                refusal = answer.exception_code
            else:
                values.update(enumerate(answer.registers, block.first))
        end_s = monotonic()
        if not values:
            reason = _EXCEPTIONS.get(refusal, "an error")
            message = f"unit {self._unit} answers with exception {refusal}: {reason}"
            raise SourceError(message)
        return Reading((begin_s + end_s) / 2, tuple(values.get(register) for register in self._registers), missed)

    async def _request(self, client: ModbusBaseClient, block: Block) -> ModbusPDU:
        """Return the answer for one block, which may be an exception response; SourceError for anything else."""
        try:
            answer = await client.read_input_registers(block.first, count=block.count, device_id=self._unit)
        except ModbusException as error:
            message = f"unit {self._unit} does not answer within {self._timeout_s * 1e3:.0f} ms"
            raise SourceError(message) from error
        fits = answer.function_code == READ_INPUT_REGISTERS and len(answer.registers) == block.count
        if not answer.isError() and not fits:
            message = f"unit {self._unit} gave the answer to another request"
            raise SourceError(message)
        return answer
