"""The aim of a placement that the options of a command ask for."""

import argparse
from typing import cast

from beamtouch_models.placement import DEFAULT_AIM, Aim
from beamtouch_models.placement.aims import Criterion
from beamtouch_models.placement.placing import Certify


def aim_of(options: argparse.Namespace) -> Aim:
    """Return the aim of `build`; raises SceneError if the options contradict each other."""
    return Aim(_criterion(options), spare=options.spare or 0)


def aim_of_place(options: argparse.Namespace, certify: Certify) -> Aim:
    """Return the aim of `place`; `certify` counts for the eigenvalue product. Raises as `aim_of`.

    Leading components and proofs are those of the eigenvalue product.
    """
    return Aim(_criterion(options), options.spare or 0, options.components, options.search, certify)


def _criterion(options: argparse.Namespace) -> Criterion:
    if options.criterion:
        return cast("Criterion", options.criterion)
    return "position-error" if options.spare else DEFAULT_AIM.criterion
