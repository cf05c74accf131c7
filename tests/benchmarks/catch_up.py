"""After an outage at 1 kHz: `python tests/benchmarks/catch_up.py [--samples 600000]` says when the record has it all.

The log and its readers as the daemon runs them, and the service as a process. While the backlog of so many samples is
brought from the file, live samples go on. A client asks for the contact all the time: its ages then, and the time of
an answer, beside those without a backlog.
"""

import argparse
import asyncio
import http.client
import json
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np

from beamtouch_common.uptime import uptime_s
from beamtouch_daemon.delivery.backlog import Backlog
from beamtouch_daemon.delivery.boots import Boot
from beamtouch_daemon.delivery.client import ServiceClient
from beamtouch_daemon.delivery.live import Live
from beamtouch_daemon.processing.pipeline import TimedSample
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.tasks import cancel
from beamtouch_service.samples import Batch, Quality, Sample
from daemon.publishing import stored
from daemon.service import TOKEN, real_service
from support.surfaces.small_model import write_model

CHANNELS = ["s1", "s2", "s3", "s4"]
COVARIANCE = [1e-8, 0.0, 1e-8, 0.0, 0.0, 1e-8, 0.0, 0.0, 0.0, 1e-8]
IN_BATCH, BATCH_S = 20, 0.02
ALONE_S, POLL_S = 15.0, 0.005


class Client:
    """Asks for the contact from a thread of its own."""

    def __init__(self, url: str) -> None:
        self.ages_ms = list[float]()
        self.took_ms = list[float]()
        self.stop = threading.Event()
        self._host = url.partition("//")[2].strip("/")
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    def _ask(self) -> None:
        connection = http.client.HTTPConnection(self._host, timeout=60)
        while not self.stop.wait(POLL_S):
            begin_s = time.monotonic()
            connection.request("GET", "/contact")
            answer = connection.getresponse()
            body = json.loads(answer.read())
            self.took_ms.append((time.monotonic() - begin_s) * 1e3)
            if answer.status == http.client.OK:
                self.ages_ms.append(body["age_ms"])

    def end(self) -> dict[str, list[float]]:
        """Stop asking; return quantiles of ages and times [ms]."""
        self.stop.set()
        self._thread.join()
        found = {"age ms": self.ages_ms, "answer ms": self.took_ms}
        return {name: np.percentile(values, (50, 99, 100)).round(1).tolist() for name, values in found.items()}


def samples(first: int, number: int) -> list[TimedSample]:
    """Return samples with these numbers, of readings that end now."""
    now_s, now_us, good = uptime_s(), int(time.time() * 1e6), [Quality.GOOD] * len(CHANNELS)
    return [
        TimedSample(
            Reading(now_s - (number - 1 - place) / 1e3, (None,) * len(CHANNELS)),
            Sample.model_construct(
                sequence=first + place,
                acquired_unix_us=now_us - (number - 1 - place) * 1000,
                deflection_mm=[1e-4, 2e-4, 0.0, 1e-4],
                quality=good,
                readings=20,
                covariance_mm2=COVARIANCE,
            ),
        )
        for place in range(number)
    ]


async def go_on(boot: Boot, is_over: Callable[[], bool]) -> None:
    """Give live samples at 1 kHz until it is over."""
    due_s = time.monotonic()
    while not is_over():
        due_s += BATCH_S
        await asyncio.sleep(max(0.0, due_s - time.monotonic()))
        boot.put(samples(boot.log.next, IN_BATCH))
        boot.wake_live()


async def run(number: int, folder: Path) -> None:
    """Fill the log while there is no service, and let it be brought."""
    model = write_model(folder, "bench", channels=len(CHANNELS))
    async with stored(folder / "log", 1_000_000_000) as store, real_service(folder, model) as url:
        head = Batch(boot_id="boot-0001", channels=CHANNELS, samples=[], noise_mm=[1e-4] * len(CHANNELS))
        logs = store.surface("bench")
        boot, sender = logs.begin(head, 20_000), ServiceClient(url, TOKEN)
        log = boot.log
        while log.next <= number:
            log.put(samples(log.next, 1000))
            boot.live.next = log.next
            await store.write(None)
        works = (Live(sender, logs, boot).run(), Backlog(sender, store, logs, asyncio.Lock()).run(), store.run())
        tasks = [asyncio.ensure_future(work) for work in works]
        client, begin_s = Client(url), time.monotonic()
        await go_on(boot, lambda: not logs.on_disk)
        print(f"{number} samples: {time.monotonic() - begin_s:.0f} s, dropped {logs.counts.dropped}", flush=True)
        print("meanwhile, p50, p99 and longest:", json.dumps(client.end()), flush=True)
        client, end_s = Client(url), time.monotonic() + ALONE_S
        await go_on(boot, lambda: time.monotonic() > end_s)
        print("alone, p50, p99 and longest:", json.dumps(client.end()), flush=True)
        await cancel(tasks)
        await sender.__aexit__()


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=600_000)
    with tempfile.TemporaryDirectory() as folder:
        asyncio.run(run(parser.parse_args().samples, Path(folder)))


if __name__ == "__main__":
    main()
