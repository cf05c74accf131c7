"""How much work a command does: the share of the layouts and the simulated contacts that it takes by default.

Every number of layouts that a search tries, of contacts that a figure is drawn from and of epochs that a training waits
is multiplied by it. Standard errors grow as its root falls, and figures state them.
"""

from dataclasses import dataclass

from beamtouch_common.errors import InputError

LEAST, MOST = 0.01, 100.0


@dataclass(frozen=True)
class Effort:
    """A share of the usual work.

    Raises
    ------
    InputError
        It is not from 0.01 to 100.
    """

    share: float = 1.0

    def __post_init__(self) -> None:
        if not LEAST <= self.share <= MOST:
            raise InputError(f"effort = {self.share:g} is not from {LEAST:g} to {MOST:g}")

    def of(self, usual: int, least: int = 2) -> int:
        """Return this share of a usual number, but `least` or the usual number if that is smaller."""
        return max(round(self.share * usual), min(least, usual))


USUAL = Effort()
