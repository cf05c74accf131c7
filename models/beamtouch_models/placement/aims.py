"""The aim of a placement: its criterion, its spare and its search."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from beamtouch_models.accuracy.prior import SampleErrors
from beamtouch_models.errors import SceneError
from beamtouch_models.physics.influence import InfluenceFunction
from beamtouch_models.placement.impossible import too_few_components
from beamtouch_models.placement.layout import Candidates
from beamtouch_models.placement.placing import Certify, Placement, place, place_by_position_error, score_positions
from beamtouch_models.placement.search_paper import SearchName
from beamtouch_models.progress import Progress, silent

Criterion = Literal["position-error", "eigenvalue-product"]


@dataclass(frozen=True)
class Aim:
    """What a placement makes best, and how it searches.

    Raises
    ------
    SceneError
        The eigenvalue product is to be placed with a spare.
    """

    criterion: Criterion
    spare: int = 0
    """Sensors that may fail, 0 or 1; see `place_by_position_error`."""
    leading: int | None = None
    """Number of eigenvalues in the product; None: all."""
    search: SearchName = "exact"
    certify: Certify = "nothing"
    """For the eigenvalue product; the position error has no bound."""

    def __post_init__(self) -> None:
        if self.spare and self.criterion != "position-error":
            message = "--spare 1 places by position error; leave out --criterion, --components and --prove"
            raise SceneError(message)


DEFAULT_AIM = Aim("position-error")
"""Its error is smaller, and it notices loads that are not one contact as often (decision 024)."""


def place_as(
    aim: Aim,
    influence: InfluenceFunction,
    rules: Candidates,
    count: int,
    seed: int,
    errors: SampleErrors,
    progress: Progress = silent,
) -> Placement:
    """Place sensors as an aim says; arguments and errors as `place_by_position_error`."""
    if aim.leading is not None and aim.leading > count:
        raise too_few_components(count, aim.leading)
    if aim.criterion == "position-error":
        found = place_by_position_error(
            influence, rules, count, seed, errors, spare=aim.spare, search=aim.search, progress=progress
        )
        score = score_positions(influence, np.array(found.positions_mm), aim.leading)
        return replace(found, log_eigenvalue_product=score)
    return place(influence, rules, count, seed, aim.leading, search=aim.search, certify=aim.certify, progress=progress)
