"""What the daemon's configuration holds: strict, every key known, units in the names.

`config_file` reads it. Whatever is wrong with it ends in a `ConfigError`.
"""

from collections import Counter
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    Field,
    FiniteFloat,
    PrivateAttr,
    ValidationInfo,
    model_validator,
)

from beamtouch_daemon.config_signal import Channel, Filter, LowPass, NoFilter, Positive, ZeroTracking
from beamtouch_daemon.config_signal import Strict as _Strict
from beamtouch_service.samples import MAX_CHANNELS, SurfaceName


class ConfigError(Exception):
    """The configuration cannot be used; the text is one line for the user."""


def reason_of(error: OSError | UnicodeDecodeError) -> str:
    """Return in a few words why a file cannot be read."""
    return (error.strerror if isinstance(error, OSError) else None) or "not text"


def _http_url(value: str) -> str:
    parts = urlsplit(value)
    if parts.scheme not in {"http", "https"} or not parts.hostname or parts.query or parts.fragment:
        message = "must look like http://127.0.0.1:8420"
        raise ValueError(message)
    _ = parts.port  # raises ValueError when it is not a port number
    return value.rstrip("/")


RelativePath = Annotated[Path, Field(strict=False)]
Milliseconds = Annotated[FiniteFloat, Field(ge=1, le=60_000)]
NetworkPort = Annotated[int, Field(ge=1, le=65_535)]
Baud = Annotated[int, Field(ge=300, le=12_000_000)]


class Publish(_Strict):
    """Where samples go."""

    url: Annotated[str, AfterValidator(_http_url)]
    """Address of the service, without a path."""
    token_file: RelativePath
    """Holds the service's bearer token and nothing else."""
    batch_ms: Annotated[FiniteFloat, Field(ge=1, le=10_000)] = 20.0
    """Samples of a surface are collected for this long and sent together."""
    queue_samples: Annotated[int, Field(ge=100, le=10_000_000)] = 20_000
    """Samples of each surface kept while the service is away; beyond it the oldest are dropped and counted."""


class ModbusTcp(_Strict):
    """Input registers of one unit over Modbus TCP."""

    kind: Literal["modbus-tcp"]
    host: Annotated[str, Field(min_length=1)]
    port: NetworkPort = 502
    unit: Annotated[int, Field(ge=0, le=255)] = 1
    timeout_ms: Milliseconds = 200.0
    """How long to wait for the connection, and for each reply."""


class ModbusRtu(_Strict):
    """Input registers of one unit over Modbus RTU, 8 data bits, no parity, 1 stop bit."""

    kind: Literal["modbus-rtu"]
    port: Annotated[str, Field(min_length=1)]
    """Path of the serial device."""
    baud: Baud = 115_200
    unit: Annotated[int, Field(ge=1, le=247)] = 1
    timeout_ms: Milliseconds = 200.0
    """How long to wait for each reply."""


class SerialLine(_Strict):
    """A device that speaks the protocol of `PROTOCOL.md`."""

    kind: Literal["serial"]
    port: Annotated[str, Field(min_length=1)]
    """Path of the serial device."""
    baud: Baud = 1_000_000
    oversampling: Annotated[int, Field(ge=1, le=255)] = 1
    """Conversions that the device averages in one reading."""


Source = Annotated[ModbusTcp | ModbusRtu | SerialLine, Field(discriminator="kind")]


class Surface(_Strict):
    """One beam with its sensors."""

    rate_hz: Annotated[FiniteFloat, Field(gt=0, le=10_000)]
    """Readings per second."""
    tare_file: RelativePath | None = None
    """Rest gaps measured by `tare`; NAME.tare.json beside the configuration unless stated."""
    noise_mm: Positive | None = None
    """Standard deviation of one reading; `tare` refuses a surface that moves more. Unset: judged from the readings.

    It also says after how many equal readings a channel is stuck.
    """
    source: Source
    filter: Filter = NoFilter()
    zero_tracking: ZeroTracking | None = None
    channels: Annotated[tuple[Channel, ...], Field(strict=False, min_length=1, max_length=MAX_CHANNELS)]

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        for what, values in (
            ("name", [channel.name for channel in self.channels]),
            ("register", [channel.register_ for channel in self.channels]),
        ):
            value, times = Counter(values).most_common(1)[0]
            if times > 1:
                message = f"two channels have the same {what} {value}"
                raise ValueError(message)
        if isinstance(self.filter, LowPass) and self.filter.cutoff_hz >= self.rate_hz / 2:
            message = f"filter.cutoff_hz must lie below half of rate_hz, {self.rate_hz / 2} Hz"
            raise ValueError(message)
        if isinstance(self.source, SerialLine) and (self.rate_hz < 1 or self.rate_hz != int(self.rate_hz)):
            message = "rate_hz must be a whole number for a serial source"
            raise ValueError(message)
        return self

    @property
    def channel_names(self) -> list[str]:
        """The channel names in their order."""
        return [channel.name for channel in self.channels]


class Config(_Strict):
    """The whole file. Relative paths in it are relative to the `directory` in the validation context."""

    publish: Publish
    surfaces: Annotated[dict[SurfaceName, Surface], Field(min_length=1)]
    _directory: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _take_directory(self, info: ValidationInfo) -> Self:
        if info.context:
            self._directory = info.context["directory"]
        return self

    @model_validator(mode="after")
    def _one_surface_per_line(self) -> Self:
        ports = Counter(s.source.port for s in self.surfaces.values() if not isinstance(s.source, ModbusTcp))
        for port, times in ports.items():
            if times > 1:
                message = f"{times} surfaces use {port}; a serial port serves one surface"
                raise ValueError(message)
        return self

    def tare_file(self, name: str) -> Path:
        """Where the rest gaps of surface `name` are kept."""
        return self._directory / (self.surfaces[name].tare_file or f"{name}.tare.json")

    def read_token(self) -> str:
        """Return the bearer token; ConfigError if there is none."""
        path = self._directory / self.publish.token_file
        try:
            token = path.read_text(encoding="ascii").strip()
        except (OSError, UnicodeDecodeError) as error:
            message = f"publish.token_file: cannot read {path} ({reason_of(error)}); put the service's token into it"
            raise ConfigError(message) from error
        if not token or not token.isprintable() or " " in token:
            message = f"publish.token_file: {path} must hold the service's token and nothing else"
            raise ConfigError(message)
        return token
