"""The daemon's configuration: unknown keys are refused, and names state their units. `config.file` reads it."""

import ssl
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import pairwise
from operator import itemgetter
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, FiniteFloat, PrivateAttr, ValidationInfo, model_validator

from beamtouch_common.errors import InputError
from beamtouch_common.outline import BEAM_AXES, BEAM_AXIS, PLATE_AXES
from beamtouch_common.secrets import read_token
from beamtouch_common.units import MM
from beamtouch_daemon.config import tare_file as tares
from beamtouch_daemon.config.modules import Module
from beamtouch_daemon.config.publish import Publish, trust
from beamtouch_daemon.config.signal import (
    LARGEST,
    Channel,
    Filter,
    GrowingMean,
    NoFilter,
    Range,
    ZeroTracking,
)
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp, NetworkPort, RelativePath, SerialLine, Source, Strict
from beamtouch_daemon.config.value_types import ValueType, ends_of, has_fractions, words_of
from beamtouch_models.filters import UNSEEN_SWING
from beamtouch_service.samples import MAX_CHANNELS, BeamIdentity, Noise, SurfaceName

MAX_PERIOD_READINGS = 4000
"""Limit of the readings in a slowest period: every sample is compared with half of them."""
MAX_MEAN_READINGS = 10_000
"""Limit of the readings in a growing mean, for memory and time."""


class Metrics(Strict):
    """Metrics for Prometheus, on this machine only."""

    port: NetworkPort | None = None
    """GET http://127.0.0.1:PORT/metrics; default: no metrics."""


class Loads(Strict):
    """The loads that the model covers; `record` refuses others."""

    position_mm: Range | None = None
    """Range of positions, from the left end of the beam."""
    x_mm: Range | None = None
    """On a plate, with `y_mm`: its range along `x`, instead of `position_mm`."""
    y_mm: Range | None = None
    """On a plate: its range along `y`."""
    max_force_n: Annotated[FiniteFloat, Field(gt=0)]
    """Largest force."""

    @model_validator(mode="after")
    def _has_axes(self) -> Self:
        if tuple(self.ranges_mm) not in {BEAM_AXES, PLATE_AXES}:
            raise ValueError("give position_mm of a beam, or x_mm and y_mm of a plate")
        for axis, (begin_mm, end_mm) in self.ranges_mm.items():
            if begin_mm > end_mm:
                raise ValueError(f"{axis}_mm = [{begin_mm:g}, {end_mm:g}]: the first must not exceed the second")
        return self

    @property
    def ranges_mm(self) -> dict[str, tuple[float, float]]:
        """Axis -> its range."""
        stated = {BEAM_AXIS: self.position_mm, "x": self.x_mm, "y": self.y_mm}
        return {axis: ends for axis, ends in stated.items() if ends is not None}


class Surface(Strict):
    """One beam with its sensors."""

    rate_hz: Annotated[FiniteFloat, Field(gt=0, le=10_000)]
    """Readings per second."""
    beam: BeamIdentity | None = None
    """Identity of the beam and its layout, as `design-sensors build` writes it; the service refuses samples of another
    beam than that of its model. Default: not stated, and a model of another beam passes unnoticed."""
    tare_file: RelativePath | None = None
    """Rest gaps that `tare` measured; default: NAME.tare.json beside the configuration."""
    noise_mm: Noise | None = None
    """Standard deviation of one reading; default: estimated from the readings.

    If successive readings are alike, that of white readings whose filtered values would scatter as much: `noise`
    measures it. `tare` refuses a surface that moves more. It also determines after how many equal readings a channel is
    stuck. Samples state their covariance only if it is given.
    """
    zero_drift_mm: Annotated[FiniteFloat, Field(ge=0, le=LARGEST)] = 0.0
    """Standard deviation of each rest gap since the last tare, from drift and warmth; `tare` allows four times as much.
    """
    slowest_period_ms: Annotated[FiniteFloat | None, Field(gt=0, le=60_000)] = None
    """Period of the slowest motion of the beam; readings that scatter within it show that the beam moves.

    Default: only the readings in the mean are compared.
    """
    unseen_swing: Annotated[FiniteFloat, Field(ge=0, le=1)] = UNSEEN_SWING
    """Swing of the beam that readings at this rate do not show, over that which they show.

    It is of modes that seem to stand still; `explain` names them. While the beam rings, samples are uncertain by it.
    """
    source: Source
    filter: Filter = NoFilter()
    """Filter from readings to samples."""
    zero_tracking: ZeroTracking | None = None
    """Follows the drift of the rest gaps, and says how uncertain they are since the last rest; needs `noise_mm`.
    Default: rest gaps are taken to stay within `zero_drift_mm` of the last tare."""
    loads: Loads | None = None
    """Default: `record` checks neither positions nor forces."""
    channels: Annotated[tuple[Channel, ...], Field(strict=False, min_length=1, max_length=MAX_CHANNELS)]
    """Sensors, in the order of the model's channels."""

    @model_validator(mode="after")
    def _has_one_kind_of_place(self) -> Self:
        kinds = {tuple(channel.place_mm) for channel in self.channels if channel.place_mm}
        if self.loads:
            kinds.add(tuple(self.loads.ranges_mm))
        if len(kinds) > 1 or kinds - {BEAM_AXES, PLATE_AXES}:
            raise ValueError(
                "places have position_mm on a beam, x_mm and y_mm on a plate, in loads and all channels alike"
            )
        return self

    @model_validator(mode="after")
    def _channels_are_distinct(self) -> Self:
        (name, same_name), *_ = Counter(self.channel_names).most_common(1)
        if same_name > 1:
            raise ValueError(f"two channels have the same name {name}")
        placed = sorted(((self.place_of(channel), channel) for channel in self.channels), key=itemgetter(0))
        for (place, channel), (next_place, following) in pairwise(placed):
            value_type, between = self.value_type_of(channel), next_place[2] - place[2]
            if next_place[:2] != place[:2] or between >= words_of(value_type):
                continue
            if not between:
                raise ValueError(f"two channels have the same register {place[2]}")
            message = (
                f"channels {channel.name} and {following.name} overlap: a value of type {value_type} takes "
                f"{words_of(value_type)} registers; correct register, or type"
            )
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _rate_is_possible(self) -> Self:
        max_hz = self.module.max_hz if self.module else None
        message = ""
        if isinstance(self.filter, GrowingMean) and self.noise_mm is None:
            message = 'filter.kind = "growing-mean" needs noise_mm; `beamtouch-daemon noise` measures it'
        elif self.zero_tracking is not None and self.noise_mm is None:
            message = "zero_tracking needs noise_mm; `beamtouch-daemon noise` measures it"
        elif isinstance(self.filter, GrowingMean) and self.filter.longest(self.rate_hz) > MAX_MEAN_READINGS:
            message = (
                f"filter.max_mean_ms: at most {MAX_MEAN_READINGS / self.rate_hz * 1e3:g}, "
                f"the time of {MAX_MEAN_READINGS} readings"
            )
        elif isinstance(self.source, SerialLine) and self.rate_hz != int(self.rate_hz):
            message = "rate_hz must be a whole number for a serial source"
        elif self.slowest_period_ms and self.slowest_period_ms * self.rate_hz / 1e3 > MAX_PERIOD_READINGS:
            message = (
                f"slowest_period_ms: at most {MAX_PERIOD_READINGS} readings, {MAX_PERIOD_READINGS / self.rate_hz:g} s"
            )
        elif max_hz is not None and self.rate_hz > max_hz:
            module = getattr(self.source, "module", "")
            message = f"rate_hz: {module} converts {max_hz:g} times a second; a higher rate would read old values again"
        if message:
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _noise_fits_the_sensors(self) -> Self:
        smallest_mm = min(high - low for low, high in (channel.range_mm for channel in self.channels))
        if self.noise_mm is not None and self.noise_mm >= smallest_mm / 2:
            message = (
                f"noise_mm = {self.noise_mm:g} is half the range of a sensor or more; "
                f"if it is in {'um' if self.value_unit == MM else 'another unit'}, write {self.noise_mm / 1e3:g}"
            )
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _channels_have_one_unit(self) -> Self:
        units = {channel.value_unit: channel.name for channel in self.channels}
        if len(units) > 1:
            (first, name), (second, other) = list(units.items())[:2]
            message = (
                f"{name} has the value_unit {first} and {other} has {second}; the channels of a surface have one, as "
                "noise_mm is that of all"
            )
            raise ValueError(message)
        return self

    @property
    def value_unit(self) -> str:
        """Unit of what all channels show."""
        return next(channel.value_unit for channel in self.channels)

    @property
    def axes(self) -> tuple[str, ...]:
        """The axes of a place, as its channels or its loads state them; those of a beam if neither does."""
        is_plate = any(channel.x_mm is not None for channel in self.channels)
        return PLATE_AXES if is_plate or (self.loads and self.loads.x_mm is not None) else BEAM_AXES

    @property
    def channel_names(self) -> list[str]:
        """The channel names in their order."""
        return [channel.name for channel in self.channels]

    @property
    def module(self) -> Module | None:
        """The module that the source names, if any."""
        return self.source.known_module

    def place_of(self, channel: Channel) -> tuple[str, int, int]:
        """Return host, unit and first register of a channel; ValueError if the configuration does not state them."""
        source, module, message = self.source, self.module, ""
        if isinstance(source, SerialLine) and (channel.input, channel.unit, channel.host, channel.type) != (None,) * 4:
            message = "input, unit, host and type are for Modbus; a serial channel has a register"
        elif isinstance(source, ModbusRtu) and channel.host is not None:
            message = "host is for modbus-tcp"
        elif (channel.input is None) == (channel.register_ is None):
            message = f"state its register{' or its input' if module else ''}"
        elif channel.input is not None and module is None:
            message = "input needs the source's module; state the register"
        elif channel.input is not None and module is not None and channel.input >= module.inputs:
            message = f"the module has inputs 0 to {module.inputs - 1}"
        elif channel.adc_bits is not None and (problem := self._misfit_of_bits(channel.adc_bits, channel)):
            message = problem
        if message:
            raise ValueError(f"channel {channel.name}: {message}")
        register = channel.register_
        if module is not None and channel.input is not None:
            register = module.register_of(channel.input)
        host, unit = getattr(source, "host", ""), getattr(source, "unit", 0)
        return channel.host or host, unit if channel.unit is None else channel.unit, register or 0

    def _misfit_of_bits(self, adc_bits: int, channel: Channel) -> str:
        """Return why counts of a channel's type cannot be those of an ADC with so many bits; empty if they can."""
        value_type = self.value_type_of(channel)
        if has_fractions(value_type):
            return f"adc_bits is for whole numbers, not {value_type}; remove it, or state counts_range"
        if 2.0**adc_bits - 1 > (largest := ends_of(value_type)[1]):
            return f"adc_bits = {adc_bits}: counts of {value_type} end at {largest:.0f}; remove it, or correct type"
        return ""

    def value_type_of(self, channel: Channel) -> ValueType:
        """Return the data type of a channel's counts; those of a serial device are whole numbers or their means."""
        return channel.type or (self.module.type if self.module else "u16")

    @property
    def value_types(self) -> list[ValueType]:
        """The data type of each channel's counts."""
        return [self.value_type_of(channel) for channel in self.channels]

    @property
    def has_fractions(self) -> list[bool]:
        """True if the counts of each channel are fractional numbers, whose type does not say their steps."""
        return [has_fractions(value_type) for value_type in self.value_types]

    @property
    def conversions(self) -> int:
        """Number of conversions that the device averages in a reading, as far as the configuration states it."""
        return self.source.conversions


class Config(Strict):
    """The whole file, with the surfaces of the files that it includes."""

    # In the validation context, `directory` is where relative paths start, and `files` has the file of each surface.

    include: Annotated[tuple[str, ...], Field(strict=False)] = ()
    """Files with further `[surfaces.NAME]` tables, as patterns such as "surfaces/*.toml", relative to this file."""
    publish: Publish
    """The service that receives the samples."""
    metrics: Metrics = Metrics()
    """Metrics for Prometheus."""
    surfaces: Annotated[dict[SurfaceName, Surface], Field(min_length=1)]
    """Surfaces by name. The service knows them by the same names."""
    _directory: Path = PrivateAttr(default=Path())
    _files: Mapping[str, Path] = PrivateAttr(default_factory=dict)

    @model_validator(mode="after")
    def _take_context(self, info: ValidationInfo) -> Self:
        if info.context:
            self._directory = info.context["directory"]
            self._files = info.context.get("files", {})
        return self

    @model_validator(mode="after")
    def _ports_can_be_shared(self) -> Self:
        users: dict[str, dict[str, ModbusRtu | SerialLine]] = {}
        for name, surface in self.surfaces.items():
            if not isinstance(surface.source, ModbusTcp):
                users.setdefault(surface.source.port, {})[name] = surface.source
        for port, sources in users.items():
            lines = {source.line if isinstance(source, ModbusRtu) else None for source in sources.values()}
            names = ", ".join(f"{name} in {self._files[name]}" if self.include else name for name in sources)
            message = ""
            if len(sources) > 1 and None in lines:
                message = f"{len(sources)} surfaces use {port} ({names}); a serial port serves one surface"
            elif len(lines) > 1:
                message = (
                    f"surfaces on {port} ({names}) state different baud, parity, stop_bits or silence_ms; "
                    "make them equal"
                )
            if message:
                raise ValueError(message)
        return self

    def choose_surfaces(self, name: str | None) -> list[str]:
        """Return the names of the surfaces that --surface means, all without it; InputError if there is none."""
        if name is not None and name not in self.surfaces:
            raise InputError(f"--surface: there is no surface {name}; choose one of {', '.join(self.surfaces)}")
        return list(self.surfaces) if name is None else [name]

    def file_of(self, name: str) -> Path:
        """Return the file that has surface `name`: the configuration, or one that it includes."""
        return self._files[name]

    @property
    def log_file(self) -> Path:
        """Path of the file of the logs."""
        return self._directory / self.publish.log_file

    @property
    def zeros_file(self) -> Path:
        """Path of the file of the zeros that are kept over a restart: the daemon may write beside its log."""
        return self.log_file.with_name(f"{self.log_file.name}.zeros.json")

    @property
    def token_file(self) -> Path:
        """Path of the file of the token."""
        return self._directory / self.publish.token_file

    def tare_file(self, name: str) -> Path:
        """Return the path of the tare file of surface `name`."""
        return self._directory / (self.surfaces[name].tare_file or f"{name}.tare.json")

    @property
    def files(self) -> list[Path]:
        """The files that the daemon reads or keeps: the included ones, and all that the configuration names."""
        publish, tare_files = self.publish, [self.tare_file(name) for name in self.surfaces]
        named = [self._directory / file for file in (publish.token_file, publish.certificate_file) if file is not None]
        return [*self._files.values(), *named, self.log_file, self.zeros_file, *tare_files]

    def read_rest_gaps(self, names: Iterable[str] | None = None) -> dict[str, dict[str, float]]:
        """Return the rest gaps [mm] by channel name of surfaces, by default of all; empty without a tare file.

        Errors as of `tare_file.load`.
        """
        return {name: {} if tare is None else tare.rest_gap_mm for name, tare in self.read_tares(names).items()}

    def read_tares(self, names: Iterable[str] | None = None) -> dict[str, tares.TareFile | None]:
        """Return the tares of surfaces, by default of all; raises what `tare_file.load` raises."""
        return {
            name: tares.load(self.tare_file(name), self.surfaces[name].channel_names)
            for name in (self.surfaces if names is None else names)
        }

    def read_trust(self) -> ssl.SSLContext | None:
        """Return the trust in certificates, None for that of the system; raises what `publish.trust` raises."""
        file = self.publish.certificate_file
        return None if file is None else trust(self._directory / file)

    def read_token(self) -> str:
        """Return the bearer token; raises what `secrets.read_token` raises."""
        remedy = "publish.token_file must name a file with the service's token"
        return read_token(self.token_file, remedy)
