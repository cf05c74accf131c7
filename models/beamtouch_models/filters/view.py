"""Two views of the same readings: as they came, and with lone spikes replaced; and which of them shows motion."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamtouch_models.filters.means import FloatArray
from beamtouch_models.filters.significance import Found


class View(NamedTuple):
    """What the last readings show about means."""

    deviations: FloatArray
    """Deviations of the readings from each mean [mm], shape (means, rows, channels); 0 if missing."""
    known: NDArray[np.bool_] | None
    """Which readings there are, of the same shape; None: all."""
    missing: FloatArray | None
    """Part of the compared readings that each channel lacks since the first reading of any; None: nothing."""
    found: Found

    def or_else(self, other: "View", own: NDArray[np.bool_]) -> "View":
        """Return a view that is another one except for some means. The same readings are missing in both."""
        columns = zip(self.found, other.found, strict=True)
        found = Found(*(np.where(own.reshape(-1, *[1] * (one.ndim - 1)), one, another) for one, another in columns))
        deviations = np.where(own[:, np.newaxis, np.newaxis], self.deviations, other.deviations)
        return View(deviations, self.known, self.missing, found)


def decide(
    raw: Found, tidy: Found, as_came: NDArray[np.bool_], newest: NDArray[np.bool_], *, moved: bool
) -> tuple[NDArray[np.bool_], bool]:
    """Return which means move, and whether the last one did; a newest reading that was replaced does not show that.

    Marks in `as_came` the means whose readings count as they came.
    """
    moves = as_came.copy()
    for index in range(len(moves)):
        as_came[index] |= moved
        found = raw if as_came[index] else tidy
        moves[index] |= found.moves[index] or (moved and found.lingers[index])
        if not newest[index]:
            moved = bool(moves[index])
        moves[index] |= newest[index]
    return moves, moved
