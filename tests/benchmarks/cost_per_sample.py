"""Processor time of daemon and service for each sample, without sockets: this code beside an older one, in turns.

`python tests/benchmarks/cost_per_sample.py [--before FOLDER] [--turns 5]`. FOLDER is a checkout of the older code
(`git worktree add FOLDER COMMIT`). Both run the same readings of the scene `bench`. Each figure is a median over pieces
or batches, and then the least of the turns, which a busy machine disturbs least. Samples and answers are compared, too.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from line_in_process import RATES, Line

ROOT = Path(__file__).parent.parent.parent
PARTS = ("models", "service", "daemon", "common", "firmware_protocol")
COURSES = ("clear", "load", "moving load")


def figures(lines: dict[int, Line]) -> tuple[dict[str, float], str]:
    """Return all figures of a turn, and a digest of all samples and contacts."""
    found, digest = dict[str, float](), hashlib.sha256()
    for rate_hz, line in lines.items():
        for course in COURSES:
            where = f"{rate_hz} Hz, {course}"
            for in_piece in sorted({1, RATES[rate_hz]}):
                found[f"daemon, {where}, readings in pieces of {in_piece}"], batches = line.daemon(course, in_piece)
            taken, posted, contacts = line.service(batches)
            found |= {f"service, {where}": taken, f"service as requests, {where}": posted}
            digest.update(b"".join([*batches, *contacts]))
    return found, digest.hexdigest()


def child() -> None:
    """Answer each line of the standard input with the figures of a turn."""
    with tempfile.TemporaryDirectory() as folder:
        lines = {rate_hz: Line(Path(folder), rate_hz) for rate_hz in RATES}
        for _ in sys.stdin:
            print(json.dumps(figures(lines)), flush=True)


def start(tree: Path) -> subprocess.Popen[str]:
    """Start a process that measures the code in a folder."""
    environment = os.environ | {"PYTHONPATH": ":".join(str(tree / part) for part in PARTS)}
    command = [sys.executable, __file__, "--child"]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)


def turns(trees: list[Path], count: int) -> list[list[tuple[dict[str, float], str]]]:
    """Return the figures of each tree in each turn."""
    children = [start(tree) for tree in trees]
    try:
        return [[_asked(one) for one in children] for _ in range(count)]
    finally:
        for one in children:
            one.kill()
            one.wait()


def _asked(one: subprocess.Popen[str]) -> tuple[dict[str, float], str]:
    assert one.stdin is not None
    assert one.stdout is not None
    one.stdin.write("\n")
    one.stdin.flush()
    found, digest = json.loads(one.stdout.readline())
    return found, digest


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--before", type=Path, help="checkout of the older code")
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.child:
        child()
        return
    found = turns([*([given.before] if given.before else []), ROOT], given.turns)
    for name in found[0][0][0]:
        least = [min(turn[place][0][name] for turn in found) for place in range(len(found[0]))]
        ratio = f"  {least[1] / least[0]:.2f} times" if given.before else ""
        print(f"{name}: {', '.join(f'{one:.0f}' for one in least)} us for a sample{ratio}")
    if given.before:
        same = {digest for turn in found for _, digest in turn}
        print("samples and contacts:", "the same bytes" if len(same) == 1 else "DIFFERENT")


if __name__ == "__main__":
    main()
