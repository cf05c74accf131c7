"""Estimators: error over the accuracy limit and time per answer, beside baselines, in one run.

`make bench` takes some cases, and one with baselines. By name, each with `[--json FILE]`:
- `python tests/benchmarks/bench_estimators.py --all`: all 288 cases of the default estimator: every scene, 2 to 5
  sensors, noise 0.01 to 10 % of the largest deflection, force known and open;
- `python tests/benchmarks/bench_estimators.py --baselines`: twelve cases with baselines, a quarter of an hour.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from estimator_baselines import baselines
from estimator_cases import Case, case_row, cases, latency_rows

COMPARED = [
    Case(name, sensors, noise, known)
    for name, sensors in (("bench", 4), ("two-spans", 3))
    for noise in (10.0, 1.0, 0.1)
    for known in (True, False)
]


def run() -> list[dict[str, object]]:
    """Some cases of the default estimator, baselines on one, latencies."""
    rows = [case_row(case) for case in cases(scenes=("bench", "cantilever", "two-spans"), counts=(4,))]
    return [*rows, *baselines(Case("bench", 4, 1.0, known=False)), *latency_rows()]


def main() -> int:
    """Run alone, with every case if asked to; returns 0."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--all", action="store_true", help="all 288 cases of the default estimator and nothing else")
    parser.add_argument("--baselines", action="store_true", help="twelve cases with baselines and nothing else")
    parser.add_argument("--latency", action="store_true", help="latencies and nothing else")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the rows to FILE")
    options = parser.parse_args()
    if options.all:
        rows = [case_row(case) for case in cases()]
    elif options.baselines:
        rows = [row for case in COMPARED for row in baselines(case)]
    else:
        rows = latency_rows() if options.latency else run()
    for row in rows:
        print("  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{value}" for key, value in row.items()))
    ratios = [float(str(row["value"])) for row in rows if row.get("unit") == "error over limit"]
    if ratios:
        print(f"{len(ratios)} cases, largest error over limit {max(ratios):.4f}")
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
