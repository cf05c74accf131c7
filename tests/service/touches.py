"""Touches of the bench as a daemon would send them: rests, contacts drawn from the scene, and sensors that change."""

from collections.abc import Callable
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from beamtouch_models import runtime
from beamtouch_models.arrays import Floats
from beamtouch_models.runtime import ModelFile
from beamtouch_service.sections import EventsSection
from service.bench import Bench, surface_with
from support.surfaces.deflections import deflections_of

Change = Callable[[Floats], Floats]

AT_REST, IN_CONTACT = 6, 5
"""Samples of each rest and of each contact."""


class Touches:
    """Contacts at random, one after another, on one surface."""

    def __init__(self, model: ModelFile, seed: int = 1) -> None:
        said = model.metadata
        self.model, self.random = model, np.random.default_rng(seed)
        channels = len(model.channels)
        self.gain, self.zero_mm = np.ones(channels), np.zeros(channels)
        self.characteristic = "as-taken"
        self.readings = 16
        self.sequence = 1
        self._noise_mm = said.noise.reading_mm / self.readings**0.5

    def batch(self, count: int, begin: datetime, every_s: float = 60.0) -> dict[str, Any]:
        """Return a batch of touches that begin at a time, with rest before and after each."""
        low, high = self.model.metadata.ranges.position_mm
        position = self.random.uniform(low, high, count)
        force = self.random.uniform(*self.model.metadata.ranges.force_n, count)
        rows, at_us = [], []
        for index, deflection_mm in enumerate(deflections_of(self.model, position, force)):
            rows += (
                [np.zeros_like(deflection_mm)] * AT_REST + [deflection_mm] * IN_CONTACT + [np.zeros_like(deflection_mm)]
            )
            first_us = round((begin.timestamp() + index * every_s) * 1e6)
            at_us += [first_us + 100_000 * place for place in range(AT_REST + IN_CONTACT + 1)]
        sequences = range(self.sequence, self.sequence + len(rows))
        self.sequence += len(rows)
        each = zip(sequences, at_us, self._measured(np.array(rows)).tolist(), strict=True)
        return {
            "boot_id": "boot-0001",
            "channels": self.model.channels,
            "newest_age_ms": 0.0,
            "characteristic": self.characteristic,
            "noise_mm": [self.model.metadata.noise.reading_mm] * len(self.model.channels),
            "samples": [
                {
                    "sequence": sequence,
                    "acquired_unix_us": acquired_us,
                    "deflection_mm": values,
                    "quality": ["good"] * len(values),
                    "readings": self.readings,
                }
                for sequence, acquired_us, values in each
            ],
        }

    def _measured(self, deflection_mm: Floats) -> Floats:
        noise: Floats = self.random.normal(size=deflection_mm.shape) * self._noise_mm
        return deflection_mm * self.gain + self.zero_mm + noise


class TouchedLine:
    """A surface that is touched again and again, with a record in a file or in memory."""

    def __init__(self, path: Path, record: Path | None = None) -> None:
        self.touches, self._record = Touches(runtime.load(path)), record
        self.start()

    def start(self) -> None:
        """Start the service anew; the old one is killed."""
        self.bench = Bench(surface_with(self.touches.model), events=EventsSection(file=self._record))
        self.bench.get("/events")  # It reads what is on record.

    def touch(self, count: int, begin: datetime, every_s: float = 60.0, change: Change = lambda one: one) -> None:
        """Send touches whose deflections are changed on their way."""
        batch = self.touches.batch(count, begin, every_s)
        for sample in batch["samples"]:
            sample["deflection_mm"] = change(np.array(sample["deflection_mm"])).tolist()
        self.bench.now_s += every_s * count
        self.bench.send(members=batch)
        self.bench.get("/events")  # It writes what there is so far.

    @property
    def summary(self) -> dict[str, Any]:
        summary: dict[str, Any] = self.bench.get("/surfaces/press-7").json()
        return summary
