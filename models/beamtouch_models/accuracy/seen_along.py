"""What a model sees along the beam at the noise of a prior."""

import numpy as np

from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.accuracy.touch_thresholds import size_per_n, smallest_force_n
from beamtouch_models.detection import UNSEEN_N, Detection, missed_shares
from beamtouch_models.loading import ModelFile

PLACES = 129


def seen_along(model: ModelFile, prior: Prior) -> Detection | None:
    """Return the smallest force and the missed contacts along the beam; None without noise or odds of a contact."""
    if "contact_log_odds" not in model.outputs or prior.noise_mm == 0:
        return None
    places = np.linspace(*prior.position_mm, PLACES)
    force = np.minimum(smallest_force_n(prior, model.metadata.thresholds.touch[-1], places), UNSEEN_N)
    return Detection(
        position_mm=places.tolist(),
        smallest_force_n=force.tolist(),
        force_n=prior.force_n[0],
        missed=missed_shares(prior.force_n[0], force, size_per_n(prior, places)),
        false_contacts_per_day=model.metadata.thresholds.false_contacts_per_day,
    )
