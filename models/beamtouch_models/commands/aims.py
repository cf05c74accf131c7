"""The aim of a placement that the options of a command ask for."""

import argparse

from beamtouch_models.placement import DEFAULT_AIM, Aim


def aim_of(options: argparse.Namespace) -> Aim:
    """Return the aim of `build`; raises SceneError if the options contradict each other."""
    spare = options.spare or 0
    return Aim(options.criterion or DEFAULT_AIM.criterion, spare)


def aim_of_place(options: argparse.Namespace) -> Aim:
    """Return the aim of `place`; raises as `aim_of`. Leading components and proofs are those of the product."""
    spare = options.spare or 0
    by_product = options.components is not None or options.prove
    criterion = options.criterion or ("eigenvalue-product" if by_product else DEFAULT_AIM.criterion)
    return Aim(criterion, spare, options.components, options.search, "proof" if options.prove else "bound")
