"""Bytes that a service writes for its record: `python tests/benchmarks/record_writes.py [--seconds 60]`.

One surface with the model of the scene `bench` and 200 contacts on record: at rest (ten samples a second), with a
contact of a second each two seconds at 200 Hz, and busy (a contact at 200 Hz that always moves). Said is what the
process gave to the disk, of `/proc/PID/io`: the pages of 4 KiB that its writes changed. `--before CHECKOUT` measures
another checkout, too. The folder must be on a disk, not in memory.
"""

import argparse
import http.client
import json
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

from serving import TOKEN, build_with, service, surfaces
from shipped import build

from beamtouch_models.runtime import ModelFile

SURFACE, WARM_S, CONTACTS = "s0", 10.0, 200
RATE_HZ, RESTING_HZ = 200, 10
Course = Callable[[float], int | None]
"""Row of the golden answers at a time [s]; None at rest."""
COURSES: dict[str, tuple[int, Course]] = {
    "at rest": (RESTING_HZ, lambda _at_s: None),
    "a contact each 2 s": (RATE_HZ, lambda at_s: int(at_s / 2) % 3 if at_s % 2 < 1 else None),
    "busy": (RATE_HZ, lambda at_s: int(at_s * 5) % 3),
}


def written(pid: int) -> int:
    """Return the bytes that a process has given to disks."""
    text = Path(f"/proc/{pid}/io").read_text()
    return int(text.partition("write_bytes:")[2].split()[0])


def send(port: int, model: ModelFile, rate_hz: int, course: Course, stop: threading.Event) -> None:
    """Send samples as a daemon does, a batch each 0.1 s, until told to stop."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
    channels, golden_mm = model.channels, model.metadata.golden.deflection_mm
    begin_s, number, durable = time.time(), 0, 0
    while not stop.wait(0.1):
        samples = []
        while number < (time.time() - begin_s) * rate_hz:
            at_s, number = number / rate_hz, number + 1
            row = course(at_s)
            samples.append(
                {
                    "sequence": number,
                    "acquired_unix_us": int((begin_s + at_s) * 1e6),
                    "deflection_mm": [0.0] * len(channels) if row is None else golden_mm[row],
                    "quality": ["good"] * len(channels),
                }
            )
        if not samples:
            continue
        batch = {"boot_id": "benchmark-1", "channels": channels, "newest_age_ms": 0.0, "samples": samples}
        batch |= {"sent_us": int(time.monotonic() * 1e6), "oldest": (durable or 0) + 1}
        connection.request("POST", f"/surfaces/{SURFACE}/samples", json.dumps(batch), headers)
        answer = connection.getresponse()
        body = answer.read()
        assert answer.status == 200, body
        durable = json.loads(body)["durable"]


def prepare(port: int, model: ModelFile) -> None:
    """Have contacts recorded, so that the history of the sensors is as long as after an hour."""
    channels, golden_mm = model.channels, model.metadata.golden.deflection_mm
    rows = [[0.0] * len(channels) if at % 40 < 15 else golden_mm[at // 40 % 3] for at in range(40 * CONTACTS + 15)]
    begin_us = int(time.time() * 1e6) - 5000 * len(rows)
    good = ["good"] * len(channels)
    connection, expected = http.client.HTTPConnection("127.0.0.1", port), 1
    while expected <= len(rows):
        part = enumerate(rows[expected - 1 : expected + 199], expected)
        samples = [
            {"sequence": at, "acquired_unix_us": begin_us + 5000 * at, "deflection_mm": row, "quality": good}
            for at, row in part
        ]
        batch = {"boot_id": "benchmark-0", "channels": channels, "samples": samples, "oldest": 1, "backlog": True}
        headers = {"Authorization": f"Bearer {TOKEN}", "Content-Type": "application/json"}
        connection.request("POST", f"/surfaces/{SURFACE}/samples", json.dumps(batch), headers)
        expected = json.loads(connection.getresponse().read())["expected"] or expected


def measure(folder: Path, name: str, seconds: float, checkout: Path | None) -> float:
    """Return the bytes per second of a service under a course."""
    model, stop = build(folder), threading.Event()
    if checkout:
        build_with(checkout, folder)
    rate_hz, course = COURSES[name]
    with service(folder, f'[events]\nfile = "events.db"\n{surfaces([SURFACE])}', checkout) as (pid, port):
        prepare(port, model)
        sender = threading.Thread(target=send, args=(port, model, rate_hz, course, stop))
        sender.start()
        time.sleep(WARM_S)
        before, begin_s = written(pid), time.monotonic()
        time.sleep(seconds)
        found = (written(pid) - before) / (time.monotonic() - begin_s)
        stop.set()
        sender.join()
    return found


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help="another checkout, to measure beside this one")
    parser.add_argument("--folder", type=Path, help="a folder on the disk")
    given = parser.parse_args()
    for name in COURSES:
        for which, checkout in (("before", given.before), ("now", None)):
            if which == "now" or checkout:
                with TemporaryDirectory(dir=given.folder) as folder:
                    per_s = measure(Path(folder), name, given.seconds, checkout and checkout.resolve())
                print(f"{name}, {which}: {per_s / 1e3:.1f} kB/s, {per_s * 3.6e3 / 1e6:.0f} MB an hour", flush=True)


if __name__ == "__main__":
    main()
