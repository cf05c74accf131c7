"""Settings of the sources: Modbus TCP, Modbus RTU and the serial protocol."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, FiniteFloat, model_validator

from beamtouch_common.files import file_path
from beamtouch_common.hosts import host_name, tcp_address
from beamtouch_daemon.config.modules import Module, module_of
from beamtouch_daemon.config.value_types import ByteOrder

Milliseconds = Annotated[FiniteFloat, Field(ge=1, le=60_000)]
Host = Annotated[str, Field(min_length=1), AfterValidator(host_name)]
NetworkPort = Annotated[int, Field(ge=1, le=65_535)]
Baud = Annotated[int, Field(ge=300, le=12_000_000)]


def _known(name: str) -> str:
    module_of(name)
    return name


def _line(path: str) -> str:
    if "://" not in path:
        return path
    try:
        _, port = tcp_address(path)
    except ValueError:
        port = None
    if port is None:
        raise ValueError("give the path of a serial device, or tcp://HOST:PORT of a serial converter")
    return path


LinePath = Annotated[str, Field(min_length=1), AfterValidator(_line)]


class Strict(BaseModel):
    """Settings that refuse unknown keys, convert no types and cannot be changed."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)


class SourceKind(Strict):
    """One kind of source, and what other folders ask of it."""

    @property
    def known_module(self) -> Module | None:
        """The module that is named, if any."""
        return None

    @property
    def is_polled(self) -> bool:
        """True if the daemon asks for each reading; otherwise the device sends them by itself."""
        return True

    @property
    def timeout_s(self) -> float:
        """Time for an answer of the device; 0 if it is not asked."""
        return 0.0

    @property
    def conversions(self) -> int:
        """Number of conversions that the device averages in a reading, as far as the configuration states it."""
        return 1


class Modbus(SourceKind):
    """Settings of Modbus TCP and RTU."""

    module: Annotated[str, AfterValidator(_known)] | None = None
    """Name of a known module; its channels may then state `input` instead of `register`."""
    function: Literal[3, 4] | None = None
    """4: input registers (default). 3: holding registers."""
    max_registers: Annotated[int, Field(ge=1, le=125)] | None = None
    """Limit of registers in one request; default: the module's, or 125."""
    bridge_registers: Annotated[int, Field(ge=0, le=124)] = 0
    """Up to this many unused registers are read along to save a request; the unit must have them."""
    byte_order: ByteOrder = "ABCD"
    """Order of the four bytes of a 32-bit value, A the most significant; BADC and DCBA also swap 16-bit values. Of f64,
    CDAB and DCBA reverse the four registers, BADC and DCBA swap the bytes of each."""

    @model_validator(mode="after")
    def _module_is_of_this_kind(self) -> Self:
        kind = self.known_module.kind if self.known_module else None
        if kind is not None and kind != getattr(self, "kind", kind):
            raise ValueError(f"module {self.module} speaks {kind}")
        return self

    @property
    def known_module(self) -> Module | None:
        """The module that is named, if any."""
        return None if self.module is None else module_of(self.module)

    @property
    def function_code(self) -> int:
        """Number of the function that reads the registers."""
        return self.function or (self.known_module.function if self.known_module else 4)

    @property
    def max_request_registers(self) -> int:
        """Limit of registers in one request."""
        return self.max_registers or (self.known_module.max_registers if self.known_module else 125)


class ModbusTcp(Modbus):
    """A device with Modbus TCP."""

    kind: Literal["modbus-tcp"]
    """A device with Modbus TCP."""
    host: Host
    """Name or address of the device; a channel may state another."""
    port: NetworkPort = 502
    """TCP port of the device."""
    unit: Annotated[int, Field(ge=0, le=255)] = 1
    """Unit identifier; a channel may state another."""
    timeout_ms: Milliseconds = 200.0
    """Timeout of the connection, and of each reply."""

    @property
    def timeout_s(self) -> float:
        """That of each reply."""
        return self.timeout_ms / 1e3


class ModbusRtu(Modbus):
    """Units on a serial bus with 8 data bits. Surfaces may share a bus if they state the same line settings."""

    kind: Literal["modbus-rtu"]
    """Units on a serial bus."""
    port: LinePath
    """Path of the serial device, or tcp://HOST:PORT of a converter that passes on the bytes of a bus. A converter has
    line settings of its own."""
    baud: Baud = 115_200
    """Bits per second, as set on the units."""
    parity: Literal["none", "even", "odd"] = "none"
    """Parity bit, as set on the units."""
    stop_bits: Annotated[int, Field(ge=1, le=2)] = 1
    """Number of stop bits, as set on the units."""
    unit: Annotated[int, Field(ge=1, le=247)] = 1
    """Address of the unit on the bus; a channel may state another."""
    timeout_ms: Milliseconds = 100.0
    """Timeout of each reply. A unit that does not answer is asked again after 13 timeouts."""
    silence_ms: Annotated[FiniteFloat, Field(ge=0, le=1000)] | None = None
    """Silence between frames; default, as in the standard: 3.5 characters, or 1.75 ms above 19200 baud."""

    @property
    def timeout_s(self) -> float:
        """That of each reply."""
        return self.timeout_ms / 1e3

    @property
    def line(self) -> tuple[object, ...]:
        """Line settings, which must be equal for all users of a bus."""
        return (self.baud, self.parity, self.stop_bits, self.silence_ms)


class SerialLine(SourceKind):
    """A device that speaks the protocol of `PROTOCOL.md`."""

    kind: Literal["serial"]
    """A device that speaks the protocol of `PROTOCOL.md`."""
    port: LinePath
    """Path of the serial device, or tcp://HOST:PORT of a converter that passes on the bytes of its line."""
    baud: Baud = 1_000_000
    """Bits per second, as set on the device."""
    oversampling: Annotated[int, Field(ge=1, le=255)] = 1
    """Number of conversions that the device averages in one reading."""

    @property
    def is_polled(self) -> bool:
        """Never."""
        return False

    @property
    def conversions(self) -> int:
        """Those of `oversampling`."""
        return self.oversampling


RelativePath = Annotated[Path, Field(strict=False), AfterValidator(file_path)]
_FROM = "Device that the readings come from."
Source = Annotated[ModbusTcp | ModbusRtu | SerialLine, Field(discriminator="kind", description=_FROM)]
