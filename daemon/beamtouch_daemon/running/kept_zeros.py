"""The zeros that are kept over a restart of the daemon, in a small JSON file beside the log.

They are those of the last rest, so a load that lies on the beam meanwhile is no part of them. Their age is taken by the
clock of `uptime_s`: the clock on the wall of a small machine may be hours behind after it was switched on. So what was
kept before the machine started is of no use.
"""

import asyncio
import logging
import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat

from beamtouch_common.encodings import decode
from beamtouch_common.files import read_bounded, write_atomically
from beamtouch_common.log_lines import Repeated
from beamtouch_common.uptime import uptime_s
from beamtouch_models.filters import Rested
from beamtouch_service.samples import SurfaceName

KEEP_S = 60.0
"""Time between two writes: after a crash, zeros may have drifted for so much longer."""
STARTED = Path("/proc/sys/kernel/random/boot_id")
"""A text that changes with each start of the machine."""
_logger = logging.getLogger(__name__)
_STRICT = ConfigDict(extra="forbid", strict=True)


class SurfaceZeros(BaseModel):
    """The zeros of one surface at its last rest."""

    model_config = _STRICT

    characteristic: str
    """That of the samples; it changes with a tare, from which the zeros count."""
    rested_s: FiniteFloat
    """Time of that rest, by the clock of `uptime_s`."""
    zero_mm: list[FiniteFloat]
    deviation_mm: list[Annotated[FiniteFloat, Field(ge=0)]]
    """Their standard deviations."""


class Content(BaseModel):
    """Content of the file."""

    model_config = _STRICT

    started: str
    """The start of the machine since which times count."""
    surfaces: dict[SurfaceName, SurfaceZeros]


class KeptZeros:
    """The kept zeros of all surfaces. Without a file, none are kept, and none are known.

    Parameters
    ----------
    path
        The file; None: there is none.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._started = path, STARTED.read_text().strip()
        self._fault = Repeated(_logger)
        self._surfaces = {} if path is None else self._read(path)

    def rested(self, name: str, characteristic: str) -> Rested | None:
        """Return the last rest of a surface before now; None if it is not known."""
        kept = self._surfaces.get(name)
        if kept is None or kept.characteristic != characteristic or kept.rested_s > uptime_s():
            return None
        return Rested(uptime_s() - kept.rested_s, tuple(kept.zero_mm), tuple(kept.deviation_mm))

    async def keep(self, zeros: Callable[[], dict[str, SurfaceZeros]]) -> None:
        """Write what is known now and then, until cancelled."""
        while True:
            await asyncio.sleep(KEEP_S)
            await asyncio.to_thread(self.write, zeros())

    def write(self, zeros: dict[str, SurfaceZeros]) -> None:
        """Write what is known of some surfaces; what was kept of others stays."""
        if self._path is None or not zeros:
            return
        self._surfaces |= zeros
        content = Content(started=self._started, surfaces=self._surfaces)
        try:
            write_atomically(self._path, content.model_dump_json().encode())
        except OSError as error:
            self._fault.failed(f"{self._path}: {error.strerror}; a restart will not know the zeros", "zeros")
        else:
            self._fault.over()

    def _read(self, path: Path) -> dict[str, SurfaceZeros]:
        try:
            content = Content.model_validate_json(decode(read_bounded(path)))
        except FileNotFoundError:
            return {}
        except OSError as error:
            _logger.warning("%s: %s; the zeros of before are not known", path, error.strerror)
        except ValueError:
            _logger.warning("%s: damaged; the zeros of before are not known", path)
        else:
            return content.surfaces if content.started == self._started else {}
        return {}


def surface_zeros(characteristic: str | None, rested: Rested | None, last_s: float | None) -> SurfaceZeros | None:
    """Return what to keep of a surface; None if it does not track its zeros, or had no reading.

    Parameters
    ----------
    characteristic
        That of the samples.
    rested
        Its last rest.
    last_s
        Time of its last reading, by the clock of `uptime_s`.
    """
    if characteristic is None or rested is None or last_s is None or not math.isfinite(rested.ago_s):
        return None
    if rested.zero_mm is None or rested.deviation_mm is None:
        return None
    return SurfaceZeros(
        characteristic=characteristic,
        rested_s=last_s - rested.ago_s,
        zero_mm=list(rested.zero_mm),
        deviation_mm=list(rested.deviation_mm),
    )
