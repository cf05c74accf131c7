"""The images of `make images`, as root: `python tests/benchmarks/containers.py [--architecture arm64]`.

A rig with a load that stays, and daemon and service in containers: read-only roots, no root user, no capability. Said
are, for each round: the time from the start of the service to its address and from that of the daemon to the first
contact, memory a while later, and the time from SIGTERM to the end. Another architecture runs in an emulator, which
`--emulator` names: a static one, of QEMU 10 or later (7.2 crashes in onnxruntime).
"""

import argparse
import os
import platform
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2] / "demo"))
sys.path.insert(0, str(Path(__file__).parent.parent))
sys.path.insert(0, str(Path(__file__).parent))

import httpx2
from shipped import build

import line
from line import Surface
from support.programs.contained_line import USER, Contained, podman_in
from support.programs.processes import resident_mb
from support.running.waiting import wait_until
from support.surfaces.example_scenes import SCENES

ROOT = Path(__file__).parents[2]
PROGRAMS = ("beamtouch-daemon", "beamtouch-service")
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
SETTLED_S = 20.0
EMULATED_STALE_MS, EMULATED_HZ = 10_000, 50
"""An emulator decides on a few samples a second: of as many as a device gives, they would all be too old."""
SCRIPT = "[[step]]\nseconds = 6000\nposition_mm = 150.0\nforce_n = 10.0\n"


class Timed(Contained):
    """A line that notes when its parts start."""

    service_s = 0.0
    """Time from the start of the service to its address."""
    daemon_began_s = 0.0

    def _start_service(self, port: int = 0) -> str:
        began_s = time.monotonic()
        url = super()._start_service(port)
        self.service_s = time.monotonic() - began_s
        return url

    def _run_daemon(self) -> None:
        self.daemon_began_s = time.monotonic()
        super()._run_daemon()


def process_of(program: str, folder: Path) -> int:
    """Return the process id of a program that runs in a container."""
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        words = entry.read_bytes().split(b"\0") if entry.exists() else []
        if f"/usr/bin/{program}".encode() in words[:4] and str(folder).encode() in b" ".join(words):
            return int(entry.parent.name)
    raise LookupError(program)


def measure(folder: Path, podman: list[str], images: dict[str, str], emulator: str) -> str:
    """Return the figures of a round in words."""
    (folder / "script.toml").write_text(SCRIPT)
    surface = Surface("bench", "modbus-tcp", folder / "script.toml", ("--no-ringing",))
    model = folder / "bench.onnx"
    sections: dict[str, Any] = {"events": {"file": "/var/lib/beamtouch/events.db"}}
    if emulator:
        sections["surfaces"] = {"bench": {"model": str(model), "stale_ms": EMULATED_STALE_MS}}
    contained = Timed(folder, SCENES / "bench.toml", model, folder / "generated.toml", [surface], sections)
    contained.podman, contained.images, contained.emulator = podman, images, emulator
    os.chown(folder, USER, USER)
    with contained:
        answer: dict[str, Any] = {}

        def touches() -> bool:
            answer.update(httpx2.get(f"{contained.url}/surfaces/bench/contact", timeout=30).json())
            return answer.get("state") == "contact"

        wait_until(touches, within_s=300, pause_s=0.02)
        contact_s = time.monotonic() - contained.daemon_began_s
        time.sleep(SETTLED_S)
        touches()
        memory = {program: resident_mb(process_of(program, folder)) for program in PROGRAMS}
        ends = []
        for name in ("daemon", "service"):
            began_s = time.monotonic()
            code = contained.end(name)
            ends.append(f"{name} {time.monotonic() - began_s:.1f} s, exit {code}")
    said = [f"service answers {contained.service_s:.1f} s", f"first contact {contact_s:.1f} s after the daemon's start"]
    said += [f"{program} {mb:.0f} MB" for program, mb in memory.items()]
    place = f"{answer['position_mm']:.1f} mm ({answer['position_low_mm']:.1f} to {answer['position_high_mm']:.1f})"
    return "; ".join([*said, *ends, f"contact at {place}, {answer['age_ms']:.0f} ms old"])


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    own = next(name for name, machine in MACHINES.items() if machine == platform.machine())
    parser.add_argument("--architecture", choices=MACHINES, default=own)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--emulator", default="/usr/bin/qemu-aarch64", help="of another architecture")
    given = parser.parse_args()
    emulator = "" if given.architecture == own else given.emulator
    line.START_TIMEOUT_S = 600.0  # an emulator is slow
    with TemporaryDirectory(prefix="pod-") as store, TemporaryDirectory() as place:
        podman = podman_in(store, "podman", "crun")
        images = {}
        for program in PROGRAMS:
            file = ROOT / "build/images" / f"{program}_{given.architecture}.tar"
            loaded = subprocess.check_output([*podman, "load", "--quiet", "--input", file], text=True)
            images[program] = loaded.split()[-1]
            print(f"{file.name}: {file.stat().st_size / 1e6:.0f} MB")
        build(Path(place), rate_hz=EMULATED_HZ if emulator else None)
        for _ in range(given.rounds):
            print(measure(Path(place), podman, images, emulator), flush=True)


if __name__ == "__main__":
    main()
