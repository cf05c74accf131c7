"""The names of estimators, criteria of placement and searches, for commands, model files and the code behind them.

Each list is here only, the default first. `--help` waits for this import.
"""

from typing import Literal, get_args

EstimatorName = Literal["posterior", "small-network", "paper-network"]
ESTIMATORS: tuple[EstimatorName, ...] = get_args(EstimatorName)

Criterion = Literal["position-error", "eigenvalue-product"]
CRITERIA: tuple[Criterion, ...] = get_args(Criterion)

SearchName = Literal["exchange", "paper"]
SEARCHES: tuple[SearchName, ...] = get_args(SearchName)
