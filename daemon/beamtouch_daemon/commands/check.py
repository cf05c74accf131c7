"""`check`: reads every channel once and prints counts, gap, deflection and quality."""

import argparse
import asyncio
import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from time import monotonic

import numpy as np

from beamtouch_common.commands import DONE
from beamtouch_common.digits import decimals_of
from beamtouch_common.errors import FailedError
from beamtouch_common.table import aligned
from beamtouch_common.units import MM
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.config.tare_file import NOT_TARED
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.readiness import readiness_of
from beamtouch_daemon.measuring.byte_orders import find_byte_orders
from beamtouch_daemon.measuring.figures import counts_text, heads_with_unit, rounded
from beamtouch_daemon.processing import resolution
from beamtouch_daemon.processing.characteristic import QUALITIES, Characteristic
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources.configured import Buses, source_of
from beamtouch_daemon.sources.reading import Reading, Source, SourceError, first_readings
from beamtouch_service.samples import Quality

PAUSE_S = 0.5
"""Pause between two attempts of --wait."""
READINGS, LONGEST_S = 30, 3.0
"""Readings of a unit that is polled, and the longest time for them: they show whether requests fail now and then."""
UNRELIABLE = 0.1
"""Share of failed requests from which on a surface is not good."""
HEAD = ("surface", "channel", "counts", "gap", "deflection", "quality")
OF_UNIT = ("gap", "deflection")
NUMBERS = (2, 3, 4)
"""Columns with numbers, which stand to the right."""
NOT_ASKED = "The service was not asked whether it takes these samples; check --wait 5 asks it."
CAUSES = {
    Quality.OUT_OF_RANGE: "the gap is outside range_mm; take everything off the beam, or correct the characteristic",
    Quality.SATURATED: "the counts stand at an end, or near 0 as without a cable; check the wiring, and counts_range",
    Quality.MISSING: "the device sent no value, NaN or more than 1e12; check unit, register (from 0), type, byte_order",
}
"""Qualities that a single reading can have beside good, with their usual causes."""


@dataclass(frozen=True, slots=True)
class ChannelCheck:
    """One channel in one reading."""

    channel: str
    counts: float | None
    gap_mm: float | None
    deflection_mm: float | None
    """Both as the channel resolves them; None for a missing count."""
    quality: Quality
    decimals: int
    """Decimals of lengths that the channel resolves."""
    unit: str
    """Unit of both."""


@dataclass(frozen=True, slots=True)
class SurfaceCheck:
    """All channels of a surface in one reading, or the error that prevented it."""

    surface: str
    file: Path
    """The configuration file that has the surface."""
    channels: tuple[ChannelCheck, ...] = ()
    error: str | None = None
    observed: str = ""
    """Traffic of a device that gives no readings."""
    limits: tuple[str, ...] = ()
    """Cases in which old or foreign readings may pass unnoticed, a sentence each."""
    is_tared: bool = True
    """True if the rest gaps are measured, rather than those of the configuration."""
    refusal: str | None = None
    """Reason why the service does not take the samples of this surface; None: it takes them, or was not asked."""
    byte_orders: tuple[str, ...] = ()
    """Byte orders with which the values would be good, which none is with the configured one."""
    doubt: str | None = None
    """Reason why the service's model seems to be that of another surface."""
    failing: tuple[str, ...] = ()
    """Units of which some requests failed, a sentence each."""
    is_unreliable: bool = False
    """True if more of them failed than can be left alone."""

    @property
    def awaited(self) -> str:
        """Channels and links that are missing and may still come; empty if none are."""
        has_all = all(channel.quality is not Quality.MISSING for channel in self.channels)
        return self.error or ("" if has_all else "not all channels arrive") or self.refusal or ""

    @property
    def full_error(self) -> str:
        """The error with what came from the device; empty without an error."""
        return "; ".join(filter(None, (self.error, self.observed)))

    def complaints(self) -> Iterator[str]:
        """Yield what prevents readings, and what prevents samples; nothing if the surface is good."""
        if self.error:
            yield self.full_error
        if self.byte_orders:
            orders = " or ".join(f'"{order}"' for order in self.byte_orders)
            yield f"with byte_order = {orders} the values would be good; correct byte_order of the source"
        for quality, cause in CAUSES.items():
            if names := [channel.channel for channel in self.channels if channel.quality is quality]:
                yield f"{', '.join(names)} {quality.value}: {cause}"
        if self.is_unreliable:
            yield from self.failing
        if self.refusal:
            yield self.refusal


def run(arguments: argparse.Namespace) -> int:
    """Run the command; FailedError if a surface is not good, InputError if a file cannot be used."""
    config = load_config(arguments.config)
    wait_s: float | None = arguments.wait
    checks = asyncio.run(_read_once(config) if wait_s is None else _wait(config, wait_s))
    complaints = [f"{check.surface}: {text}" for check in checks for text in check.complaints()]
    if arguments.json:
        surfaces = {check.surface: _as_json(check, asked=wait_s is not None) for check in checks}
        print(json.dumps({"good": not complaints, "surfaces": surfaces}))
    else:
        print("\n".join(_lines(checks, with_files=bool(config.include))))
        if wait_s is None:
            print(NOT_ASKED)
    if complaints:
        raise FailedError(*complaints)
    return DONE


async def _read_once(config: Config) -> list[SurfaceCheck]:
    """Check once; InputError if a tare file does not fit."""
    return await _read_all(config, _sources_of(config))


async def _wait(config: Config, wait_s: float) -> list[SurfaceCheck]:
    """Check until all channels arrive and the service takes samples, for about `wait_s` [s]; return the last checks.

    An attempt that has begun is completed. InputError if a tare file, the token or a certificate cannot be used.
    """
    deadline_s = monotonic() + wait_s
    printed: list[str] = []
    async with ServiceClient.of(config) as client, AsyncExitStack() as stack:
        sources = _sources_of(config)
        for source in sources.values():
            stack.enter_context(source.kept_open())
        while True:
            checks = await _read_all(config, sources)
            checks = await asyncio.gather(*(_ask(client, check, config.surfaces[check.surface]) for check in checks))
            waiting = [f"waiting: {check.surface}: {check.awaited}" for check in checks if check.awaited]
            left_s = deadline_s - monotonic()
            if not waiting or left_s <= 0:
                return checks
            if waiting != printed:
                print(*waiting, sep="\n", file=sys.stderr, flush=True)
                printed = waiting
            await asyncio.sleep(min(PAUSE_S, left_s))


async def _ask(client: ServiceClient, check: SurfaceCheck, surface: Surface) -> SurfaceCheck:
    readiness = await readiness_of(client, check.surface, surface)
    return replace(check, refusal=readiness.refusal, doubt=readiness.doubt)


def _sources_of(config: Config) -> dict[str, Source]:
    buses: Buses = {}
    return {name: source_of(surface, name, buses) for name, surface in config.surfaces.items()}


async def _read_all(config: Config, sources: Mapping[str, Source]) -> list[SurfaceCheck]:
    """Read every surface, all at the same time; InputError if a tare file does not fit."""
    rest = config.read_rest_gaps()

    async def read(name: str, surface: Surface) -> SurfaceCheck:
        source = sources[name]
        try:
            *_, reading = await first_readings(source, _readings_of(surface))
        except SourceError as error:
            return SurfaceCheck(
                name, config.file_of(name), error=error.reason, observed=error.observed, is_tared=bool(rest[name])
            )
        return SurfaceCheck(
            name,
            config.file_of(name),
            _channels(surface, rest[name], reading),
            limits=source.limits,
            is_tared=bool(rest[name]),
            byte_orders=tuple(find_byte_orders(surface, reading.counts)),
            failing=tuple(filter(None, (requests.describe(unit) for unit, requests in source.requests.items()))),
            is_unreliable=any(requests.failed_share >= UNRELIABLE for requests in source.requests.values()),
        )

    return await asyncio.gather(*(read(name, surface) for name, surface in config.surfaces.items()))


def _readings_of(surface: Surface) -> int:
    """Return the number of readings to take: some, if requests for them may fail now and then."""
    if not surface.source.is_polled:
        return 1
    return max(1, min(READINGS, round(LONGEST_S * surface.rate_hz)))


def _channels(surface: Surface, rest_gap_mm: dict[str, float], reading: Reading) -> tuple[ChannelCheck, ...]:
    characteristic = Characteristic.of(surface, rest_gap_mm)
    counts = counts_of([reading])
    (gaps,) = characteristic.gap(counts)
    deflections = characteristic.deflection(gaps)
    qualities = [QUALITIES[code] for code in characteristic.quality(counts)[0].tolist()]
    steps_mm = np.maximum(resolution.finest(surface) * characteristic.steepest, surface.noise_mm or 0.0)
    checks = []
    for index, (name, count) in enumerate(zip(surface.channel_names, reading.counts, strict=True)):
        decimals = decimals_of(float(steps_mm[index]))
        gap_mm = deflection_mm = None
        if not math.isnan(gaps[index]):
            gap_mm = rounded(float(gaps[index]), decimals)
            deflection_mm = rounded(float(deflections[index]), decimals)
        checks.append(ChannelCheck(name, count, gap_mm, deflection_mm, qualities[index], decimals, surface.value_unit))
    return tuple(checks)


def _as_json(check: SurfaceCheck, *, asked: bool) -> dict[str, object]:
    """Return the check of a surface for JSON; `asked`: whether the service was asked."""
    return {
        "file": str(check.file),
        "error": check.full_error or None,
        "channels": [
            {
                **{key: value for key, value in asdict(channel).items() if key != "decimals"},
                "counts": None if channel.counts is None else json.loads(counts_text(channel.counts)),
            }
            for channel in check.channels
        ],
        "limits": check.limits,
        "tared": check.is_tared,
        "failing": check.failing,
        "service": (check.refusal or "takes samples") if asked else None,
        "doubt": check.doubt,
    }


def _lines(checks: Sequence[SurfaceCheck], *, with_files: bool) -> Iterator[str]:
    """Yield the table, with the file of each surface if there are several, and below it what limits the readings."""
    channels = [(check, channel) for check in checks for channel in check.channels]
    head, ends = heads_with_unit(HEAD, OF_UNIT, [channel.unit for _, channel in channels])
    if all(channel.unit != MM for _, channel in channels):
        head = [name.replace("gap", "value") for name in head]
    rows = [
        (
            check.surface,
            channel.channel,
            "-" if channel.counts is None else counts_text(channel.counts),
            *(
                "-" if length_mm is None else f"{length_mm:.{channel.decimals}f}{end}"
                for length_mm in (channel.gap_mm, channel.deflection_mm)
            ),
            channel.quality.value,
            *[str(check.file)] * with_files,
        )
        for (check, channel), end in zip(channels, ends, strict=True)
    ]
    yield from aligned([*head, *["file"] * with_files], rows, right=NUMBERS)
    for check in checks:
        failing = () if check.is_unreliable else check.failing
        texts = (*check.limits, *failing, "" if check.is_tared else NOT_TARED, check.doubt)
        yield from (f"{check.surface}: {text}" for text in texts if text)
