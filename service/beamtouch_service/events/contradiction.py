"""An unexplained sample, channel by channel. Pure: no clock, no state, no I/O."""

from __future__ import annotations

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from pydantic import BaseModel

from beamtouch_service.surfaces.contact import rfc3339

if TYPE_CHECKING:
    from collections.abc import Mapping

    from beamtouch_models.modelfile import Evidence, LeftOut, Metadata
    from beamtouch_service.surfaces.estimates import Estimated

_DIGITS = 6
"""Significant digits; the answers of a graph have seven."""


class ChannelDoubt(BaseModel):
    """One channel that took part."""

    name: str
    deflection_mm: float
    """Positive in the direction of the load."""
    standard_error_mm: float | None
    """Error of that deflection, as the sender states it."""
    rest_residual: float | None
    """The deflection in units of its total error, free of what the channels before it explain by their common error.
    The squares of all channels add up to `rest_misfit`."""
    misfit_without: float | None
    """`misfit` without this channel; null where too few channels would be left to contradict each other."""
    rest_misfit_without: float | None
    """`rest_misfit` without this channel."""
    explained_without: bool
    """Whether rest or a single contact explains all other channels."""


class Contradiction(BaseModel):
    """A sample that neither rest nor a single contact explains."""

    sequence: int
    sampled_at: str
    """Time of the sample by the sender's clock (RFC 3339)."""
    readings: int | None
    """Number of readings in the sample; null if its sender does not say."""
    misfit: float | None
    """Misfit of the best single contact."""
    misfit_limit: float
    """A larger `misfit` is no contact."""
    rest_misfit: float | None
    """Misfit of rest."""
    rest_limit: float
    """A larger `rest_misfit` is no rest."""
    log_odds: float | None
    """Log odds of contact over rest [nats]."""
    channels: list[ChannelDoubt]
    """Channels in the order of the model."""


def contradiction(
    metadata: Metadata, estimated: Estimated, evidence: Evidence, without: Mapping[str, LeftOut]
) -> Contradiction:
    """Return an unexplained sample channel by channel; `without` has its misfits without each channel."""
    weighed, row, place = estimated.weighed, estimated.row, evidence.channels - 1
    residuals = evidence.whitening_per_mm @ evidence.deflection_mm
    errors_mm = np.sqrt(np.diagonal(weighed.covariance_mm2[row]))
    channels = []
    for index, channel in enumerate(metadata.layout):
        if not weighed.valid[row, index]:
            continue
        left = without.get(channel.name)
        channels.append(
            ChannelDoubt(
                name=channel.name,
                deflection_mm=_short(weighed.deflection_mm[row, index]),
                standard_error_mm=_rounded(errors_mm[index]),
                rest_residual=_rounded(residuals[index]),
                misfit_without=_rounded(left.misfit) if left else None,
                rest_misfit_without=_rounded(left.rest_misfit) if left else None,
                explained_without=left is not None and left.explained,
            )
        )
    return Contradiction(
        sequence=estimated.sequence,
        sampled_at=rfc3339(estimated.acquired_unix_us),
        readings=estimated.readings,
        misfit=_rounded(evidence.misfit),
        misfit_limit=metadata.thresholds.misfit[place],
        rest_misfit=_rounded(evidence.rest_misfit),
        rest_limit=metadata.thresholds.rest[place],
        log_odds=_rounded(evidence.log_odds),
        channels=channels,
    )


def _rounded(value: float) -> float | None:
    return _short(value) if isfinite(value) else None


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
