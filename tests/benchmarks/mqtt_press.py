"""A service of one surface with a broker, and the sender of its samples."""

import http.client
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep, time, time_ns

from service.small_model import write_model

BATCH_S = 0.02
"""From batch to batch; each has two samples."""
TOUCHING_BATCHES, RESTING_BATCHES = 4, 4
STALE_S = 0.5
TOKEN = "a-token-of-this-benchmark"  # noqa: S105


class Press:
    """A service of one surface, and the sender of its samples."""

    def __init__(self, folder: Path, port: int | None, rate_hz: int | None = 20) -> None:
        (folder / "token").write_text(TOKEN)
        mqtt = f"[mqtt]\nhost = '127.0.0.1'\nport = {port}\nmax_rate_hz = {rate_hz}\n" if port else ""
        config = folder / "service.toml"
        config.write_text(
            "[server]\nport = 0\nwrite_token_file = 'token'\n[events]\nfile = 'events.db'\n"
            f"{mqtt}[surfaces.press-7]\nmodel = '{write_model(folder)}'\nstale_ms = {STALE_S * 1e3}\n"
        )
        program = [sys.executable, "-m", "beamtouch_service.cli", "run", "--config", str(config)]
        self._log = (folder / "log").open("wb")
        self.process = subprocess.Popen(program, stdout=subprocess.PIPE, stderr=self._log, text=True)
        assert self.process.stdout is not None
        port = int(self.process.stdout.readline().rpartition(":")[2])
        self._client = http.client.HTTPConnection("127.0.0.1", port)
        self._sequence = 0
        self.receipts: dict[int, float] = {}
        """Sequence number -> time of the receipt [s since 1970]. On a busy machine, a batch is old when it arrives."""

    def get(self, path: str) -> bytes:
        self._client.request("GET", path)
        return self._client.getresponse().read()

    def metric(self, name: str) -> float:
        lines = self.get("/metrics").decode().splitlines()
        return float(next(line.split()[-1] for line in lines if line.startswith(f"beamtouch_mqtt_{name} ")))

    def contact(self) -> None:
        """Touch and lift once."""
        for _ in range(TOUCHING_BATCHES):
            self._send([0.5, 0.25, 0.125])
        for _ in range(RESTING_BATCHES):
            self._send([0.0, 0.0, 0.0])

    def _send(self, row: list[float]) -> None:
        begin_s, now_us = monotonic(), time_ns() // 1000
        samples = [
            {
                "sequence": self._sequence + index,
                "acquired_unix_us": now_us - 10_000 * (1 - index),
                "deflection_mm": row,
                "quality": ["good"] * 3,
            }
            for index in range(2)
        ]
        self._sequence += 2
        batch = {"boot_id": "boot-0001", "channels": ["s1", "s2", "s3"], "newest_age_ms": 0.0, "samples": samples}
        headers = {"Authorization": f"Bearer {TOKEN}"}
        self._client.request("POST", "/surfaces/press-7/samples", json.dumps(batch), headers)
        answer = self._client.getresponse()
        said = answer.read()
        assert answer.status == 200, said
        self.receipts[self._sequence - 1] = time()
        sleep(max(0.0, begin_s + BATCH_S - monotonic()))

    def since_receipt_ms(self, sequence: int, at_s: float) -> float:
        """Return the time from the receipt of a sample [ms]; less than 0 if its contact was faster."""
        return (at_s - self.receipts[sequence]) * 1e3

    def close(self) -> None:
        self.process.terminate()
        self.process.communicate()
        self._log.close()


@contextmanager
def press(within: str, port: int | None, rate_hz: int | None = 20) -> Iterator[Press]:
    one = Press(Path(tempfile.mkdtemp(dir=within)), port, rate_hz)
    try:
        yield one
    finally:
        one.close()
