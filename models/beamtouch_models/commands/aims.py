"""The aim of a placement that the options of a command ask for."""

import argparse

from beamtouch_models.placement import Aim
from beamtouch_models.placement.aims import Criterion
from beamtouch_models.placement.placing import Certify


def aim_of(options: argparse.Namespace) -> Aim:
    """Return the aim of `build`; raises SceneError if the options contradict each other."""
    return Aim(criterion=options.criterion or "position-error", spare=options.spare or 0)


def aim_of_place(options: argparse.Namespace, certify: Certify) -> Aim:
    """Return the aim of `place`; `certify` counts for the eigenvalue product. Raises as `aim_of`.

    Leading components and proofs are those of the eigenvalue product.
    """
    by_product = options.components is not None or options.prove
    criterion: Criterion = options.criterion or ("eigenvalue-product" if by_product else "position-error")
    return Aim(criterion, options.spare or 0, options.components, options.search, certify)
