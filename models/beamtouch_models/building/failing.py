"""The accuracy limit of a layout with one sensor failed, and what to say of it."""

from beamtouch_common.digits import digits
from beamtouch_models.accuracy.limit import accuracy_limit
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.metadata import LayoutErrors, Metadata
from beamtouch_models.placement import Criterion

DRAWS, FEWEST_DRAWS = 4_096, 256
"""Simulated contacts, shared between the sensors, and the smallest number for each; bounds the time of a build."""
TOO_MUCH = 2.0
"""Ratio of the error with one sensor failed to that with all from which a build warns."""


def placed_of(prior: Prior, criterion: Criterion, spare: int, seed: int) -> LayoutErrors:
    """Measure how a layout fares with all sensors, and with each one failed."""
    draws = max(FEWEST_DRAWS, DRAWS // prior.channels)
    failed = range(prior.channels if prior.channels > 1 else 0)
    return LayoutErrors(
        criterion=criterion,
        spare=spare,
        limit_percent=accuracy_limit(prior, draws, seed).percent,
        limit_without_percent=[accuracy_limit(prior.without(index), draws, seed).percent for index in failed],
    )


def weak_spot(metadata: Metadata) -> str:
    """Say whether one failed sensor ends a surface or doubles its error; empty if neither."""
    layout, found = metadata.layout, metadata.placed
    if found is None:
        return ""
    remedy = "add a sensor" if found.spare else "add a sensor, or place them with --spare 1"
    if metadata.min_channels == len(layout):
        if len(layout) == 1:
            return "one failed sensor ends this surface: it has no other; add one"
        return f"one failed sensor ends this surface: all {len(layout)} channels must work; {remedy}"
    worst = max(found.limit_without_percent)
    if worst < TOO_MUCH * found.limit_percent:
        return ""
    name = layout[found.limit_without_percent.index(worst)].name
    return (
        f"if {name} fails, the mean position error grows from {digits(found.limit_percent, 3)} to {digits(worst, 3)} "
        f"% of the length; {remedy}"
    )
