"""The filter of deflections, and the covariance of what it gives. Numpy only, and pure.

Values have shape (readings, channels), oldest first. Any split of the stream gives the same result, to the bit, and
nothing drifts: means come from running sums of whole numbers, which are exact, and every other value is computed from
the same rows in the same order. Only readings of neither noise nor step are counted so finely that sums of many are
rounded: then splits differ, by far less than a nanometre.

NaN marks a reading of a channel that is not good. Its result is NaN, and it never affects a later value: a mean
continues with the good readings in its window. A lost reading is a row of NaN in all channels.

A kind of filter is a kind of `Mean`, which `Chain` runs. Samples state 1 / `relative_variance` as their number of
readings, so it is a whole number for every kind.
"""

from beamtouch_models.filters.chain import Chain, Mean, readings_within, unit_of
from beamtouch_models.filters.filtered import Filtered
from beamtouch_models.filters.hurry import Hurried
from beamtouch_models.filters.readings import FloatArray
from beamtouch_models.filters.rest import Rest
from beamtouch_models.filters.ringing import UNSEEN_SWING
from beamtouch_models.filters.walk import PERSISTS_S, TARED, Rested, Tracked, Walk, beyond_start
from beamtouch_models.filters.zeros import Zeros

__all__ = [
    "PERSISTS_S",
    "TARED",
    "UNSEEN_SWING",
    "Chain",
    "Filtered",
    "FloatArray",
    "Hurried",
    "Mean",
    "Rest",
    "Rested",
    "Tracked",
    "Walk",
    "Zeros",
    "beyond_start",
    "readings_within",
    "unit_of",
]
