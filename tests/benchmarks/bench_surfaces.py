"""What a surface costs the service, at rest, at 1 kHz, per batch and in memory: on one core, with senders on others."""

import json
import os
import sys
import tempfile
from pathlib import Path
from time import sleep

sys.path.insert(0, str(Path(__file__).parent.parent))

from serving import TOKEN, loaded, service, surfaces
from shipped import build

from support.programs.processes import processor_s, resident_mb

MOST, SECONDS = 48, 3.0
RESTING = 200
PROMPT_MS = 20.0
"""A core carries the samples if from the taking of one to its receipt it takes no longer, but for 1 in 100."""
PRESSED, IN_BATCH = 8, (4, 1)
"""Surfaces whose senders wait for nothing, and the samples in their batches: a daemon sends each 4 ms."""
MEMORIES = (1, 100, 500)


def run() -> list[dict[str, object]]:
    """Measure what a core carries, many surfaces at rest, batches, and services without samples."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = build(folder)
        moved = json.dumps(dict(zip(model.channels, model.metadata.golden.deflection_mm[0], strict=True)))
        calm = json.dumps(dict.fromkeys(model.channels, 0.0))
        cores = sorted(os.sched_getaffinity(0))
        os.sched_setaffinity(0, cores[-1:])  # inherited by the service
        try:
            with service(folder, surfaces(f"s{number}" for number in range(RESTING))) as (pid, port):
                os.sched_setaffinity(0, cores[:-1] or cores)
                rows = [carried(pid, port, moved)]
                rows += [at_rest(pid, port, calm, count) for count in (MOST, RESTING)]
                rows.append({"name": f"memory with {RESTING} surfaces", "value": resident_mb(pid), "unit": "MB"})
                rows += [batch(pid, port, moved, size) for size in IN_BATCH]
        finally:
            os.sched_setaffinity(0, cores)
        return [*rows, *(idle(folder, count) for count in MEMORIES)]


def carried(pid: int, port: int, channels: str) -> dict[str, object]:
    """Look for the number of surfaces of 1 kHz that a core carries, by doubling and then by halves."""
    kept: tuple[int, dict[str, float], float] = 0, {"samples": 0, "batches": 1, "p50_ms": 0.0, "p99_ms": 0.0}, 0.0
    low, high = 0, MOST + 1
    count = 1
    while high - low > 1:
        found, used_s = sent(pid, port, channels, count, 1000, 0.004)
        if found["p99_ms"] <= PROMPT_MS:
            low, kept = count, (count, found, used_s)
        else:
            high = count
        count = min(2 * low, MOST) if high > MOST else (low + high) // 2
    count, found, used_s = kept
    return {
        "name": "surfaces of 1 kHz that one core carries",
        "value": count,
        "unit": "surfaces",
        "samples/s": found["samples"] / SECONDS,
        "samples in a batch": found["samples"] / found["batches"],
        "p50 to the receipt, ms": found["p50_ms"],
        "p99 to the receipt, ms": found["p99_ms"],
        "processor, %": used_s / SECONDS * 100,
    }


def at_rest(pid: int, port: int, channels: str, count: int) -> dict[str, object]:
    """Measure so many surfaces at rest."""
    found, used_s = sent(pid, port, channels, count, 10, 0.1)
    return {
        "name": f"{count} surfaces at rest, 10 samples per second each",
        "value": used_s / SECONDS * 100,
        "unit": "% of a core",
        "samples/s of each": found["samples"] / SECONDS / count,
        "p50 to the receipt, ms": found["p50_ms"],
        "p99 to the receipt, ms": found["p99_ms"],
    }


def batch(pid: int, port: int, channels: str, size: int) -> dict[str, object]:
    """Measure batches of a size, from senders that wait for their receipts only."""
    found, used_s = sent(pid, port, channels, PRESSED, 1000, 0, size)
    return {"name": f"processor time of a batch of {size}", "value": used_s / found["batches"] * 1e6, "unit": "us"}


def sent(pid: int, port: int, channels: str, count: int, *pace: float) -> tuple[dict[str, float], float]:
    """Send to so many surfaces for a turn; returns what the senders found, and the processor time that it took [s]."""
    return loaded(pid, "sample_load.py", port, channels, count, SECONDS, TOKEN, *pace)


def idle(folder: Path, count: int) -> dict[str, object]:
    """Measure a service with so many surfaces that gets no samples."""
    with service(folder, surfaces(f"s{number}" for number in range(count))) as (pid, _):
        begin_s = processor_s(pid)
        sleep(SECONDS)
        share = (processor_s(pid) - begin_s) / SECONDS
        memory_mb = resident_mb(pid)
    name = f"memory with {count} surfaces without samples"
    return {"name": name, "value": memory_mb, "unit": "MB", "% of a core": 100 * share}
