"""`tare`: measures the rest gaps, with nothing on the beam, and keeps them in the tare file."""

import argparse
import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import TypeVar

import numpy as np

from beamtouch_common.commands import DONE
from beamtouch_common.digits import decimals_of
from beamtouch_common.errors import FailedError, InputError
from beamtouch_daemon.config import tare_file
from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.config.settings import Config, Surface
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.readiness import calibration_on, contact_on
from beamtouch_daemon.measuring import at_rest, tares
from beamtouch_daemon.measuring.at_rest import NotAtRestError
from beamtouch_daemon.processing import stuck
from beamtouch_daemon.processing.pipeline import counts_of
from beamtouch_daemon.sources.configured import source_of
from beamtouch_daemon.sources.reading import SourceError, first_readings
from beamtouch_models.filters import FloatArray

REMEDY = (
    "take everything off the beam and tare again, or add --accept-change if the sensors were moved or the beam was "
    "changed"
)
FIRST_REMEDY = (
    "take everything off the beam and tare again, or add --accept-change if nothing touches it: before the first tare, "
    "a load and a sensor mounted elsewhere look alike"
)
WARMTH_REMEDY = (
    "all have changed about alike, by {:+.3f} {}, as in a hall that warms or cools, and unlike most loads: look that "
    "nothing touches the beam, wait until it no longer drifts, and add --accept-change; if the hall does so often, "
    "state how fast in zero_tracking.drift_um_per_min"
)

_T = TypeVar("_T")

MIN_DECIMALS = 4
"""Decimals of a rest gap, also where the noise would allow fewer."""


def run(arguments: argparse.Namespace) -> int:
    """Run the command; FailedError if a surface was not tared, InputError if the configuration cannot be used."""
    config, failures = load_config(arguments.config), list[str]()
    for name in config.choose_surfaces(arguments.surface):
        try:
            _tare(config, name, accept_change=arguments.accept_change)
        except FailedError as error:
            failures += error.args
    if failures:
        raise FailedError(*failures)
    return DONE


def _tare(config: Config, name: str, *, accept_change: bool) -> None:
    """Tare one surface; FailedError if that is impossible."""
    surface, path = config.surfaces[name], config.tare_file(name)
    try:
        last = config.read_tares([name])[name]
    except (InputError, FailedError):
        last = None  # a file that cannot be used is replaced
    last_mm, since_s = ({}, math.inf) if last is None else (last.rest_gap_mm, last.age_s(datetime.now(UTC)))
    try:
        readings = asyncio.run(first_readings(source_of(surface), at_rest.readings_for_tare(surface.rate_hz)))
        gaps = _measure_rest(counts_of(readings), surface, last_mm, since_s, accept_change=accept_change)
        contact = asyncio.run(_ask(config, lambda client: contact_on(client, name)))
        if contact and not accept_change:
            raise NotAtRestError(f"the service sees {contact}; {REMEDY}")
        tare_file.save(path, name, len(readings), gaps, surface.channels)
    except (SourceError, NotAtRestError) as error:
        raise FailedError(f"{name}: not tared: {error}") from error
    except OSError as error:
        raise FailedError(f"{name}: cannot write {path}: {error.strerror}") from error
    decimals = max(MIN_DECIMALS, decimals_of(surface.noise_mm or 1.0))
    text = ", ".join(f"{channel} {gap:.{decimals}f} {surface.value_unit}" for channel, gap in gaps.items())
    print(f"{name}: rest gaps {text}, mean of {len(readings)} readings, in {path}")
    answers = {None: "the service could not be asked, or has no contact to give", "": "the service sees a beam at rest"}
    answer = answers.get(contact, f"the service sees {contact}")
    print(f"{name}: {tares.describe_comparison(gaps, last_mm, surface, since_s)}; {answer}")
    moved = tares.find_moved(gaps, last_mm, surface, since_s)
    changed = [] if last is None else last.other_characteristics(surface.channels)
    if moved or changed:
        is_calibrated = asyncio.run(_ask(config, lambda client: calibration_on(client, name))) or False
        print(f"{name}: {_describe_new(moved, changed, is_calibrated=is_calibrated)}")
    print(f"{name}: a running daemon takes them when it starts again: systemctl restart beamtouch-daemon")


def _measure_rest(
    counts: FloatArray, surface: Surface, last_mm: Mapping[str, float], since_s: float, *, accept_change: bool
) -> dict[str, float]:
    """Return the rest gaps [mm] by channel name; NotAtRestError if the beam moves, or they contradict earlier ones."""
    gaps = at_rest.rest_gaps(counts, surface)
    longest = stuck.Runs.of(surface).lengths(counts).max(axis=0)
    too_long = np.flatnonzero(longest > stuck.longest_runs(surface)).tolist()
    names = [surface.channel_names[index] for index in too_long] or at_rest.find_frozen(counts, surface)
    if names:
        raise NotAtRestError(at_rest.stuck_complaint(names))
    contradictions = tares.find_contradictions(gaps, last_mm, surface, since_s)
    if contradictions and not accept_change:
        warmth_mm = tares.common_mm(gaps, last_mm, surface)
        remedy = (
            WARMTH_REMEDY.format(warmth_mm, surface.value_unit) if warmth_mm else REMEDY if last_mm else FIRST_REMEDY
        )
        raise NotAtRestError(f"{', '.join(contradictions)}; {remedy}")
    return gaps


def _describe_new(moved: Sequence[str], changed: Sequence[str], *, is_calibrated: bool) -> str:
    """Say what to do if the sensors that have moved by themselves, or whose characteristic is another one, are new."""
    signs = (("another rest gap", moved), ("another characteristic", changed))
    what = ", ".join(f"{sign} of {' and '.join(names)}" for sign, names in signs if names)
    again = " again, as its calibration is of the sensors from before" if is_calibrated else ""
    return (
        f"{what}: if a sensor is new or stands elsewhere, calibrate the model{again}; until then, a contact may be "
        "unexplained or misplaced"
    )


async def _ask(config: Config, question: Callable[[ServiceClient], Awaitable[_T | None]]) -> _T | None:
    """Return what the service answers to a question; None if it cannot be asked."""
    try:
        client = ServiceClient.of(config)
    except (InputError, FailedError):
        return None  # the daemon has the token from elsewhere
    async with client:
        return await question(client)
