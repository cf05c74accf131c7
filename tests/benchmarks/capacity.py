"""Processor time and memory of a service per surface: `python tests/benchmarks/capacity.py [--seconds 10]`.

Senders press as hard as they can with batches of the size that daemons send. The processor time per batch does not
count the time in which other programs have the core, so a busy machine can measure it too.
"""

import argparse
import http.client
import json
import sys
import tempfile
import threading
from pathlib import Path
from time import monotonic, sleep, time

sys.path.insert(0, str(Path(__file__).parent))

from bench_service import TOKEN, server
from shipped import build

from processes import processor_s, resident_mb

PRESSED = 8
"""Surfaces that are fed at once."""
RATES = {1000: 4, 200: 1, 50: 1}
"""Rate in Hz -> samples in a batch of the daemon, which sends every 4 ms."""
MEMORIES = (1, 100, 500)
USED = 0.6
"""Share of a core that is planned for: the rest is for questions, and for the surfaces of a service that died."""


def press(port: int, surface: str, channels: dict[str, float], in_batch: int, until_s: float, sent: list[int]) -> None:
    """Send batches to one surface, one after the other."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    quality = ["good"] * len(channels)
    count = 0
    while monotonic() < until_s:
        now_us = int(time() * 1e6)
        samples = [
            {
                "sequence": count * in_batch + place + 1,
                "acquired_unix_us": now_us + place * 1000,
                "deflection_mm": list(channels.values()),
                "quality": quality,
            }
            for place in range(in_batch)
        ]
        boot_id = f"boot-{surface}-{in_batch}"
        body = {"boot_id": boot_id, "channels": list(channels), "newest_age_ms": 0.0, "samples": samples}
        headers = {"Authorization": f"Bearer {TOKEN}"}
        connection.request("POST", f"/surfaces/{surface}/samples", json.dumps(body), headers)
        answer = connection.getresponse()
        said = answer.read()
        assert answer.status == 200, said
        count += 1
    connection.close()
    sent.append(count)


def batch_s(pid: int, port: int, channels: dict[str, float], in_batch: int, seconds: float) -> float:
    """Return the processor time of a batch [s]."""
    begin_s, until_s = processor_s(pid), monotonic() + seconds
    sent: list[int] = []
    senders = [
        threading.Thread(target=press, args=(port, f"s{number}", channels, in_batch, until_s, sent))
        for number in range(PRESSED)
    ]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join()
    assert len(sent) == PRESSED
    return (processor_s(pid) - begin_s) / sum(sent)


def configured(folder: Path, surfaces: int) -> tuple[str | Path, ...]:
    """Write a configuration; returns the arguments of the service."""
    text = "".join(f'[surfaces.s{number}]\nmodel = "bench.onnx"\n' for number in range(surfaces))
    (folder / "service.toml").write_text(f'[server]\nport = 0\nwrite_token_file = "token"\n{text}')
    return "-m", "beamtouch_service.cli", "run", "--config", folder / "service.toml"


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=10.0)
    seconds: float = parser.parse_args().seconds
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        model = build(folder)
        (folder / "token").write_text(TOKEN)
        channels = dict(zip(model.channels, model.metadata.golden.deflection_mm[0], strict=True))
        with server(*configured(folder, PRESSED)) as (service, port):
            cost_s = {size: batch_s(service.pid, port, channels, size, seconds) for size in set(RATES.values())}
        for rate_hz, size in RATES.items():
            most = size / (cost_s[size] * rate_hz)
            words = f"{rate_hz} Hz: {cost_s[size] * 1e6:.0f} us per batch of {size}"
            print(f"{words}; a core carries {most:.1f} surfaces, {USED * most:.1f} at {USED:.0%}", flush=True)
        for surfaces in MEMORIES:
            with server(*configured(folder, surfaces)) as (service, _):
                begin_s = processor_s(service.pid)
                sleep(seconds)
                idle = (processor_s(service.pid) - begin_s) / seconds
                memory_mb = resident_mb(service.pid)
            print(f"{surfaces} surfaces without samples: {memory_mb:.0f} MB, {idle:.1%} of a core", flush=True)


if __name__ == "__main__":
    main()
