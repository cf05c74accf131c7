"""Rest gaps: measured while nothing touches the beam, kept in a small file beside the configuration."""

import math
import os
import tempfile
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from beamtouch_daemon.config.settings import ConfigError, Surface
from beamtouch_daemon.processing.characteristic import QUALITIES, Calibration
from beamtouch_service.samples import ChannelName, Quality, SurfaceName

DURATION_S = 1.0
MIN_READINGS = 50
"""Below this, chance alone looks like motion too often."""
MAX_SPREAD = 2.0
"""The standard deviation of a surface at rest, over the noise of one reading."""
MAX_DRIFT = 1.0
"""The difference between the means of both halves, over the noise of one reading."""
DRIFT_DEVIATIONS = 5.0
"""The same, over its own standard deviation: with many readings much less than `MAX_DRIFT` is motion."""
MOUNTED_WITHIN = 0.1
"""Part of a sensor's linear range by which its rest gap may differ from the configured one, which may be nominal."""
DRIFTS_WITHIN = 0.02
"""Part of a sensor's linear range by which warmth and settling move a rest gap between two tares."""


class TareRefusedError(Exception):
    """The surface was not at rest, or does not look so; the text is one line for the user."""


class TareFile(BaseModel):
    """What `tare` writes and `run` reads."""

    model_config = ConfigDict(extra="forbid", strict=True)

    surface: SurfaceName
    taken_at: str
    """UTC, ISO 8601; for the record."""
    readings: int
    """How many were averaged."""
    rest_gap_mm: dict[ChannelName, FiniteFloat]


def readings_needed(rate_hz: float) -> int:
    """Return how many readings to average."""
    return max(MIN_READINGS, math.ceil(DURATION_S * rate_hz))


def rest_gaps(
    counts: NDArray[np.float64], calibration: Calibration, channels: Sequence[str], noise_mm: float | None
) -> dict[str, float]:
    """Return the mean gap of each channel [mm], by name.

    Parameters
    ----------
    counts
        Shape (readings, channels), NaN where missing.
    calibration
        Gives gaps and qualities.
    channels
        Names in column order.
    noise_mm
        Standard deviation of one reading [mm]; None: judged from the differences between successive readings, which a
        slow motion hardly changes.

    Raises
    ------
    TareRefusedError
        If a channel is not good throughout, or the surface moved: its spread or its drift exceeds what the noise and
        one step of the ADC explain.
    """
    codes = calibration.quality(counts)
    gaps = calibration.gap(counts)
    for name, code, gap, step in zip(channels, codes.T, gaps.T, calibration.steepest.tolist(), strict=True):
        if bad := code[code != QUALITIES.index(Quality.GOOD)].tolist():
            message = f"{name} is {QUALITIES[bad[0]]} in {len(bad)} of {len(gap)} readings; check the sensor"
            raise TareRefusedError(message)
        if moved := motion(gap, step, noise_mm):
            message = f"{name} moved: {moved}; take everything off the beam and try again"
            raise TareRefusedError(message)
    return dict(zip(channels, np.mean(gaps, axis=0).tolist(), strict=True))


def noise_of(gap_mm: NDArray[np.float64], noise_mm: float | None) -> float:
    """Return the noise of a reading [mm]: as stated, or judged from the differences between successive readings."""
    return float(np.std(np.diff(gap_mm))) / math.sqrt(2.0) if noise_mm is None else noise_mm


def motion(gap_mm: NDArray[np.float64], step_mm: float, noise_mm: float | None) -> str:
    """Say how far the gaps of a channel, shape (readings,), moved; empty if noise and one ADC step explain them."""
    noise = noise_of(gap_mm, noise_mm)
    spread = float(np.std(gap_mm))
    first, second = np.array_split(gap_mm, 2)
    drift = abs(float(np.mean(second) - np.mean(first)))
    # The difference of two means of n / 2 readings has a standard deviation of 2 / sqrt(n) of that of a reading.
    most_drift = min(MAX_DRIFT, DRIFT_DEVIATIONS * 2 / math.sqrt(len(gap_mm))) * noise
    if spread <= MAX_SPREAD * noise + step_mm and drift <= most_drift + step_mm:
        return ""
    return f"standard deviation {spread:.2g} mm, drift {drift:.2g} mm, noise {noise:.2g} mm"


def contradictions(rest_gap_mm: Mapping[str, float], last_mm: Mapping[str, float], surface: Surface) -> list[str]:
    """Say of each channel whose rest gap cannot be right by what is known of it, by how much it differs, and from what.

    A channel without a last tare is compared with the configuration, which may be nominal. With one it is compared with
    both, but with the configuration only if the last tare agreed with it.

    Parameters
    ----------
    rest_gap_mm
        As measured, by channel name.
    last_mm
        Of the last tare, by channel name; empty without one.
    surface
        The configuration.
    """
    noise = surface.noise_mm or 0.0
    followed = surface.zero_tracking.most_mm if surface.zero_tracking else 0.0
    found = []
    for channel in surface.channels:
        gap, width = rest_gap_mm[channel.name], channel.range_mm[1] - channel.range_mm[0]
        last = last_mm.get(channel.name)
        mounted, drifted = MOUNTED_WITHIN * width + noise, max(DRIFTS_WITHIN * width, followed) + noise
        if last is not None and abs(gap - last) > drifted:
            found.append(f"{channel.name} {gap - last:+.3f} mm from the last tare")
            continue
        agreed = last is None or abs(last - channel.rest_gap_mm) <= mounted
        if agreed and abs(gap - channel.rest_gap_mm) > mounted:
            found.append(f"{channel.name} {gap - channel.rest_gap_mm:+.3f} mm from its rest_gap_mm")
    return found


def save(path: Path, surface: str, readings: int, rest_gap_mm: dict[str, float]) -> None:
    """Write a tare file whole or not at all; OSError if that is impossible."""
    now = datetime.now(UTC).isoformat(timespec="seconds")
    content = TareFile(surface=surface, taken_at=now, readings=readings, rest_gap_mm=rest_gap_mm)
    write_atomically(path, content.model_dump_json(indent=2) + "\n")


def load(path: Path, channels: Sequence[str]) -> dict[str, float]:
    """Return the rest gaps [mm] by channel name, none if there is no file; ConfigError if it does not fit."""
    try:
        content = TareFile.model_validate_json(path.read_bytes())
    except FileNotFoundError:
        return {}
    except (OSError, ValidationError) as error:
        message = f"{path}: not a tare file; delete it or run beamtouch-daemon tare again"
        raise ConfigError(message) from error
    if set(content.rest_gap_mm) != set(channels):
        message = f"{path}: was made for other channels; delete it or run beamtouch-daemon tare again"
        raise ConfigError(message)
    return content.rest_gap_mm


def write_atomically(path: Path, text: str) -> None:
    """Replace a file so that at no moment it is there in part; OSError if that is impossible."""
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
