"""The daemon's configuration: unknown keys are refused, and names state their units. `config.file` reads it."""

from collections import Counter
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, FiniteFloat, PrivateAttr, ValidationInfo, model_validator

from beamtouch_daemon.config.modules import Encoding, module_of
from beamtouch_daemon.config.publish import Publish, read_certificates, read_token
from beamtouch_daemon.config.signal import Channel, Filter, GrowingMean, LowPass, NoFilter, Pair, Positive, ZeroTracking
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp, NetworkPort, RelativePath, SerialLine, Source, Strict
from beamtouch_service.samples import MAX_CHANNELS, SurfaceName

MAX_PERIOD_READINGS = 4000
"""Limit of the readings in a slowest period: every sample is compared with half of them."""
MAX_MEAN_READINGS = 10_000
"""Limit of the readings in a growing mean, for memory and time."""


class Metrics(Strict):
    """Metrics for Prometheus, on this machine only."""

    port: NetworkPort | None = None
    """GET http://127.0.0.1:PORT/metrics; default: no metrics."""


def place_of(source: Source, channel: Channel) -> tuple[str, int, int]:
    """Return host, unit and first register of a channel; ValueError if the configuration does not state them."""
    message = ""
    module = None if isinstance(source, SerialLine) or source.module is None else module_of(source.module)
    if isinstance(source, SerialLine) and (channel.input, channel.unit, channel.host, channel.type) != (None,) * 4:
        message = f"channel {channel.name}: input, unit, host and type are for Modbus; a serial channel has a register"
    elif isinstance(source, ModbusRtu) and channel.host is not None:
        message = f"channel {channel.name}: host is for modbus-tcp"
    elif (channel.input is None) == (channel.register_ is None):
        message = f"channel {channel.name}: state its register{' or its input' if module else ''}"
    elif channel.input is not None and module is None:
        message = f"channel {channel.name}: input needs the source's module; state the register"
    elif channel.input is not None and module is not None and channel.input >= module.inputs:
        message = f"channel {channel.name}: the module has inputs 0 to {module.inputs - 1}"
    if message:
        raise ValueError(message)
    register = channel.register_
    if register is None and module is not None and channel.input is not None:
        register = module.register_of(channel.input)
    host, unit = getattr(source, "host", ""), getattr(source, "unit", 0)
    return channel.host or host, unit if channel.unit is None else channel.unit, register or 0


def encoding_of(source: Source, channel: Channel) -> Encoding:
    """Return the data type of the counts of a channel; those of a serial device are whole numbers or their means."""
    module = None if isinstance(source, SerialLine) else source.module
    known: Encoding = "u16" if module is None else module_of(module).type
    return channel.type or known


class Loads(Strict):
    """The loads that the model covers; `record` refuses others."""

    position_mm: Pair
    """Range of positions, from the left end of the beam."""
    max_force_n: Positive
    """Largest force."""


class Surface(Strict):
    """One beam with its sensors."""

    rate_hz: Annotated[FiniteFloat, Field(gt=0, le=10_000)]
    """Readings per second."""
    tare_file: RelativePath | None = None
    """Rest gaps that `tare` measured; default: NAME.tare.json beside the configuration."""
    noise_mm: Positive | None = None
    """Standard deviation of one reading; default: estimated from the readings.

    If successive readings are alike, that of white readings whose filtered values would scatter as much: `noise`
    measures it. `tare` refuses a surface that moves more. It also determines after how many equal readings a channel is
    stuck. Samples state their covariance only if it is given.
    """
    slowest_period_ms: Annotated[FiniteFloat | None, Field(gt=0, le=60_000)] = None
    """Period of the slowest motion of the beam; readings that scatter within it show that the beam moves.

    Default: only the readings in the mean are compared.
    """
    source: Source
    filter: Filter = NoFilter()
    """Filter from readings to samples."""
    zero_tracking: ZeroTracking | None = None
    """Follows a slow drift of the rest gaps; default: no tracking."""
    loads: Loads | None = None
    """Default: `record` checks neither positions nor forces."""
    channels: Annotated[tuple[Channel, ...], Field(strict=False, min_length=1, max_length=MAX_CHANNELS)]
    """Sensors, in the order of the model's channels."""

    @model_validator(mode="after")
    def _names_are_distinct(self) -> Self:
        name, times = Counter(channel.name for channel in self.channels).most_common(1)[0]
        if times > 1:
            message = f"two channels have the same name {name}"
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _rate_is_possible(self) -> Self:
        module = getattr(self.source, "module", None)
        max_hz = None if module is None else module_of(module).max_hz
        message = ""
        if isinstance(self.filter, LowPass) and self.filter.cutoff_hz >= self.rate_hz / 2:
            message = f"filter.cutoff_hz must lie below half of rate_hz, {self.rate_hz / 2} Hz"
        elif isinstance(self.filter, GrowingMean) and self.noise_mm is None:
            message = 'filter.kind = "growing-mean" needs noise_mm; `beamtouch-daemon noise` measures it'
        elif isinstance(self.filter, GrowingMean) and self.filter.longest(self.rate_hz) > MAX_MEAN_READINGS:
            message = (
                f"filter.max_mean_ms: at most {MAX_MEAN_READINGS / self.rate_hz * 1e3:g}, "
                f"the time of {MAX_MEAN_READINGS} readings"
            )
        elif isinstance(self.source, SerialLine) and (self.rate_hz < 1 or self.rate_hz != int(self.rate_hz)):
            message = "rate_hz must be a whole number for a serial source"
        elif (self.slowest_period_ms or 0.0) * self.rate_hz / 1e3 > MAX_PERIOD_READINGS:
            message = (
                f"slowest_period_ms: at most {MAX_PERIOD_READINGS} readings, {MAX_PERIOD_READINGS / self.rate_hz:g} s"
            )
        elif max_hz is not None and self.rate_hz > max_hz:
            message = f"rate_hz: {module} converts {max_hz:g} times a second; a higher rate would read old values again"
        if message:
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _channels_can_be_read(self) -> Self:
        places = Counter(place_of(self.source, channel) for channel in self.channels)
        (_, _, register), times = places.most_common(1)[0]
        if times > 1:
            message = f"two channels have the same register {register}"
            raise ValueError(message)
        return self

    @property
    def channel_names(self) -> list[str]:
        """The channel names in their order."""
        return [channel.name for channel in self.channels]

    @property
    def conversions(self) -> int:
        """Number of conversions that the device averages in a reading, as far as the configuration states it."""
        return self.source.oversampling if isinstance(self.source, SerialLine) else 1


class Config(Strict):
    """The whole file. Relative paths in it start from the `directory` in the validation context."""

    publish: Publish
    """The service that receives the samples."""
    metrics: Metrics = Metrics()
    """Metrics for Prometheus."""
    surfaces: Annotated[dict[SurfaceName, Surface], Field(min_length=1)]
    """Surfaces by name. The service knows them by the same names."""
    _directory: Path = PrivateAttr(default=Path())

    @model_validator(mode="after")
    def _take_directory(self, info: ValidationInfo) -> Self:
        if info.context:
            self._directory = info.context["directory"]
        return self

    @model_validator(mode="after")
    def _ports_can_be_shared(self) -> Self:
        users: dict[str, list[ModbusRtu | SerialLine]] = {}
        for surface in self.surfaces.values():
            if not isinstance(surface.source, ModbusTcp):
                users.setdefault(surface.source.port, []).append(surface.source)
        for port, sources in users.items():
            lines = {source.line if isinstance(source, ModbusRtu) else None for source in sources}
            message = ""
            if len(sources) > 1 and None in lines:
                message = f"{len(sources)} surfaces use {port}; a serial port serves one surface"
            elif len(lines) > 1:
                message = f"surfaces on {port} state different baud, parity, stop_bits or silence_ms; make them equal"
            if message:
                raise ValueError(message)
        return self

    @property
    def spool_file(self) -> Path:
        """Path of the spool."""
        return self._directory / self.publish.spool_file

    def tare_file(self, name: str) -> Path:
        """Return the path of the tare file of surface `name`."""
        return self._directory / (self.surfaces[name].tare_file or f"{name}.tare.json")

    def read_certificates(self) -> str | None:
        """Return the certificates to trust (PEM), None for those of the system; InputError if they cannot be used."""
        file = self.publish.certificate_file
        return None if file is None else read_certificates(self._directory / file)

    def read_token(self) -> str:
        """Return the bearer token; InputError if it cannot be read."""
        return read_token(self._directory / self.publish.token_file)
