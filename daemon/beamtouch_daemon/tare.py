"""Rest gaps: measured while nothing touches the beam, kept in a small file beside the configuration."""

import math
import os
import tempfile
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, FiniteFloat, ValidationError

from beamtouch_daemon.calibration import QUALITIES, Calibration
from beamtouch_daemon.config import ConfigError
from beamtouch_service.samples import ChannelName, Quality, SurfaceName

DURATION_S = 1.0
MIN_READINGS = 50
"""Below this, chance alone looks like motion too often."""
MAX_SPREAD = 2.0
"""The standard deviation of a surface at rest, over the noise of one reading."""
MAX_DRIFT = 1.0
"""The difference between the means of both halves, over the noise of one reading."""


class TareRefusedError(Exception):
    """The surface was not at rest; the text is one line for the user."""


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
    for name, code, gap, step in zip(channels, codes.T, gaps.T, calibration.steepest, strict=True):
        if bad := code[code != QUALITIES.index(Quality.GOOD)].tolist():
            message = f"{name} is {QUALITIES[bad[0]]} in {len(bad)} of {len(gap)} readings; check the sensor"
            raise TareRefusedError(message)
        noise = float(np.std(np.diff(gap))) / math.sqrt(2.0) if noise_mm is None else noise_mm
        spread = float(np.std(gap))
        first, second = np.array_split(gap, 2)
        drift = abs(float(np.mean(second) - np.mean(first)))
        if spread > MAX_SPREAD * noise + step or drift > MAX_DRIFT * noise + step:
            message = (
                f"{name} moved: standard deviation {spread:.2g} mm, drift {drift:.2g} mm, noise {noise:.2g} mm; "
                "take everything off the beam and try again"
            )
            raise TareRefusedError(message)
    return dict(zip(channels, np.mean(gaps, axis=0).tolist(), strict=True))


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
