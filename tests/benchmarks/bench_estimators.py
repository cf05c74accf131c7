"""Estimators: error over the accuracy limit and time per answer, beside baselines, in one run."""

from estimator_baselines import baselines
from estimator_cases import Case, case_row, cases, latency_rows


def run() -> list[dict[str, object]]:
    """Some cases of the default estimator, baselines on one, latencies."""
    rows = [case_row(case) for case in cases()]
    return [*rows, *baselines(Case("bench", 4, 1.0, known=False)), *latency_rows()]
