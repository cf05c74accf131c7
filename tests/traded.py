"""The points of a trade, measured in this process."""

from collections.abc import Callable

from beamtouch_models.scene import Scene
from beamtouch_models.sweeps import in_turn
from beamtouch_models.trade.layouts import layouts_of, measured
from beamtouch_models.trade.point import Trade
from beamtouch_models.trade.points import Points


def points_of(scene: Scene, draws: int, keep: Callable[[Trade], None] = lambda _trade: None) -> Trade:
    """Return the points of the default estimator; `keep` is called with the points so far."""
    layouts = layouts_of(scene, ("posterior",), draws=draws, seed=0)
    points = Points(layouts, in_turn(measured, layouts))
    points.gather(lambda _done: None, keep)
    return points.timed(lambda _done: None)
