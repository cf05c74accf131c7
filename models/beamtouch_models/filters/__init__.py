"""Filters of deflections, and the covariance of what they give. Numpy only, and pure.

Values have shape (readings, channels), oldest first. Every stage takes a state and returns the next one; the state
holds the rows that are still needed, and NaN for rows that do not exist yet. Any split of the stream gives the same
result, to the bit, and nothing drifts: the growing mean keeps running sums of whole numbers, which are exact, and every
other value is computed from the same rows in the same order.

NaN marks a reading of a channel that is not good. Its result is NaN, and it never affects a later value: a moving
average continues with the good readings in the window. A lost reading is a row of NaN in all channels.
"""

from beamtouch_models.filters.chain import Chain
from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.rest import Rest
from beamtouch_models.filters.stages import (
    Stage,
    chosen_stages,
    filled,
    growing_mean_stage,
    moving_average_stage,
    readings_within,
    spike_stage,
    unit_of,
)

__all__ = [
    "Chain",
    "Filtered",
    "FloatArray",
    "Rest",
    "Stage",
    "chosen_stages",
    "filled",
    "growing_mean_stage",
    "moving_average_stage",
    "readings_within",
    "spike_stage",
    "unit_of",
]
