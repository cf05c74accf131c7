"""What `publish.rest_ms` costs and saves: `python tests/benchmarks/rest_trade.py [--touches 200] [--rate-hz 200]`.

The scene `bench`. For each `rest_ms`: processor time of daemon and service for a second at rest, and how long after
touches of 0.5, 1 and 1.5 times the smallest force, at any place, the service says contact. Without sockets: a reading
is taken, and its samples are published, when it comes.
"""

import argparse
import copy
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np
from shipped import build

from beamtouch_daemon.config.file import load_config
from beamtouch_daemon.processing.filters import rest_of
from beamtouch_daemon.processing.pipeline import Pipeline, TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_models.design.scene import load_scene
from beamtouch_models.lab.rig.loads import Load
from beamtouch_models.lab.rig.surface import VirtualSurface
from beamtouch_models.runtime import State
from beamtouch_service.samples import Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.surface import Surface

REST_MS = (0, 20, 50, 100, 200, 400)
FORCES = (0.5, 1.0, 1.5)
"""Times the smallest force that is seen at that place."""
NO_LOAD = Load(None, 0.0)
SETTLED_S, AT_REST_S, TOUCHED_S = 3.0, 20.0, 2.0
STALE_MS = 60_000.0


@dataclass
class Taking:
    """Takes readings as the acquisition of the daemon does."""

    pipeline: Pipeline
    rest_s: float
    waiting: list[Reading]
    sampled_s: float = 0.0

    def take(self, reading: Reading) -> list[TimedSample]:
        """Return the samples that are published with this reading."""
        self.waiting.append(reading)
        is_due = reading.monotonic_s - self.sampled_s >= self.rest_s
        if len(self.waiting) <= self.pipeline.most_waiting and not is_due and self.pipeline.explains(reading):
            return []
        readings, self.waiting, self.sampled_s = self.waiting, [], reading.monotonic_s
        return self.pipeline.process(readings, 1.7e9)


class Trade:
    """One beam at one rate."""

    def __init__(self, folder: Path, rate_hz: int) -> None:
        self.model, self.period_s = build(folder, rate_hz=rate_hz), 1 / rate_hz
        self.scene, _ = load_scene(folder / "bench.toml")
        self.settings = load_config(folder / "generated.toml").surfaces["bench"]
        self.beam = VirtualSurface(self.scene, self.model.metadata, seed=0, rings=False)
        self.rng = np.random.default_rng(0)

    def reading(self, number: int, load: Load = NO_LOAD) -> Reading:
        """Return the reading of that number."""
        at_s = number * self.period_s
        return Reading(at_s, tuple(self.beam.counts(load, at_s)))

    def settled(self, rest_ms: int) -> tuple[Taking, int]:
        """Return a beam at rest, and the number of its next reading."""
        rest = rest_of(self.settings) if rest_ms else None
        taking, count = Taking(Pipeline(self.settings, rest=rest), rest_ms / 1e3, []), round(SETTLED_S / self.period_s)
        for number in range(count):
            taking.take(self.reading(number))
        return taking, count

    def at_rest_ms(self, rest_ms: int) -> tuple[float, float, float]:
        """Return the processor time of daemon and service for a second at rest [ms], and the samples in it."""
        (taking, begin), surface, samples = self.settled(rest_ms), self.served(), 0
        spent_s = [0.0, 0.0]
        for number in range(begin, begin + round(AT_REST_S / self.period_s)):
            reading, begin_s = self.reading(number), process_time()
            taken = taking.take(reading)
            taken_s = process_time()
            if taken:
                surface.receive(self.batch(taken), number * self.period_s)
            spent_s[0] += taken_s - begin_s
            spent_s[1] += process_time() - taken_s
            samples += len(taken)
        return spent_s[0] / AT_REST_S * 1e3, spent_s[1] / AT_REST_S * 1e3, samples / AT_REST_S

    def served(self) -> Surface:
        """Return the surface of a service."""
        return Surface("bench", self.model, SurfaceSection(stale_ms=STALE_MS))

    def batch(self, taken: list[TimedSample]) -> Batch:
        """Return a live batch."""
        head = {"boot_id": "benchmark-1", "channels": self.settings.channel_names, "newest_age_ms": 0.0}
        return Batch.model_validate({**head, "samples": [one.sample.model_dump() for one in taken]})

    def delay_ms(self, taking: Taking, number: int, load: Load) -> float:
        """Return the time from a touch to a contact [ms]; infinite if there is none within `TOUCHED_S`."""
        surface, begin = self.served(), number + int(self.rng.integers(20, 100))
        for at in range(number, begin):
            if taken := taking.take(self.reading(at)):
                surface.receive(self.batch(taken), at * self.period_s)
        for at in range(begin, begin + round(TOUCHED_S / self.period_s)):
            if taken := taking.take(self.reading(at, load)):
                surface.receive(self.batch(taken), at * self.period_s)
                if surface.view(at * self.period_s).state is State.CONTACT:
                    return (at - begin + self.rng.uniform()) * self.period_s * 1e3
        return float("inf")

    def touches(self, rest_ms: int, factor: float, count: int) -> list[float]:
        """Return the delays of so many touches [ms]."""
        settled, seen = self.settled(rest_ms), self.model.metadata.smallest_force
        delays = []
        seen_n = [np.nan if force_n is None else force_n for force_n in seen.force_n]
        for position_mm in self.rng.uniform(min(seen.position_mm), max(seen.position_mm), count):
            force_n = factor * float(np.interp(position_mm, seen.position_mm, seen_n))
            taking, number = copy.deepcopy(settled)
            delays.append(self.delay_ms(taking, number, Load(float(position_mm), force_n)))
        return delays


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--touches", type=int, default=200, help="of each force and each rest_ms")
    parser.add_argument("--rate-hz", type=int, default=200)
    parser.add_argument("--rest-ms", type=int, nargs="*", default=REST_MS)
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        trade = Trade(Path(folder), given.rate_hz)
        for rest_ms in given.rest_ms:
            daemon_ms, service_ms, samples = trade.at_rest_ms(rest_ms)
            row: dict[str, object] = {"rest_ms": rest_ms, "samples per s": samples}
            row |= {"daemon, ms per s": round(daemon_ms, 2), "service, ms per s": round(service_ms, 2)}
            for factor in FORCES:
                delays = np.array(trade.touches(rest_ms, factor, given.touches))
                p50, p99 = np.percentile(delays, (50, 99), method="inverted_cdf")
                row[f"{factor} times the smallest force"] = {
                    "p50 ms": round(p50, 1), "p99 ms": round(p99, 1), "no contact": int(np.isinf(delays).sum()),
                }  # fmt: skip
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
