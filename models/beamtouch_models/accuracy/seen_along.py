"""What a model sees along the beam at the noise of a prior."""

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.touch_thresholds import size_per_n, smallest_forces
from beamtouch_models.detection import Detection, missed_shares
from beamtouch_models.loading import ModelFile


def seen_along(model: ModelFile, prior: Prior) -> Detection | None:
    """Return the smallest force and the missed contacts along the beam; None without noise or odds of a contact."""
    if "contact_log_odds" not in model.outputs or prior.noise_mm == 0:
        return None
    supports_mm = [support.at_mm for support in model.metadata.drawn.supports]
    seen = smallest_forces(prior, model.metadata.thresholds.touch[-1], supports_mm)
    size = size_per_n(prior, np.array(seen.position_mm))
    return Detection(
        position_mm=seen.position_mm,
        smallest_force_n=seen.force_n,
        force_n=prior.force_n[0],
        missed=missed_shares(prior.force_n[0], seen.force_n, size),
        false_contacts_per_day=model.metadata.thresholds.false_contacts_per_day,
    )
