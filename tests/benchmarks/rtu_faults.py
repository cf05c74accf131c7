"""Polls of a Modbus RTU unit under every pattern of faults: how many values are stale or foreign, and what they cost.

    python tests/benchmarks/rtu_faults.py --polls 20000

The daemon's own source polls a unit on a pseudo-terminal as fast as it answers. The last column is the rate over that
of a bus without faults whose unit takes as long for an answer.
"""

import argparse
import asyncio
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from daemon import faulty_bus

_WIDTH = 50


def main() -> int:
    """Print a table; return 1 if a pattern that is provable gave a stale or foreign value."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--polls", type=int, default=20_000, help="over all patterns (default 20000)")
    parser.add_argument("--seed", type=int, default=1, help="of the faults (default 1)")
    parser.add_argument("--only", default="", metavar="TEXT", help="only patterns with this in their name")
    options = parser.parse_args()
    patterns = faulty_bus.patterns(options.seed)
    chosen = {name: one for name, one in patterns.items() if options.only in name}
    each = options.polls // len(chosen)
    print(f"| {'pattern':{_WIDTH}} | polls | answered | stale | foreign | answers/s | of a bus without faults |")
    print(f"|{'-' * (_WIDTH + 2)}|---|---|---|---|---|---|")
    total, wrong, bare_hz = 0, 0, 0.0
    for name, pattern in chosen.items():
        found = asyncio.run(faulty_bus.run(pattern, each, options.seed))
        bare_hz = bare_hz or found.rate_hz
        note = "" if pattern.is_provable else " (unprovable)"
        cells = f"{found.polls} | {found.answered} | {found.stale} | {found.foreign} | {found.rate_hz:.0f}"
        without_hz = 1 / (1 / bare_hz + pattern.busy_s)
        print(f"| {name + note:{_WIDTH}} | {cells} | {found.rate_hz / without_hz:.2f} |", flush=True)
        total += found.polls
        wrong += (found.stale + found.foreign) * pattern.is_provable
    print(f"\n{total} polls; {wrong} stale or foreign where the order of answers can be proven")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
