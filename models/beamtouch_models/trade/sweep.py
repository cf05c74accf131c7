"""The trade of one scene: its tasks, and its results so far."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from beamtouch_models.accuracy.statistics import Measurement
from beamtouch_models.building.checks import check_scene
from beamtouch_models.estimators.estimator import Name
from beamtouch_models.pricing.noise import choose_filter
from beamtouch_models.progress import Progress
from beamtouch_models.scene import Scene
from beamtouch_models.sweeps import Spread
from beamtouch_models.trade.layouts import counts_of, layouts_of, measured
from beamtouch_models.trade.physics import EffectLeftOut, Question, errors_left_out, physics_trade
from beamtouch_models.trade.point import Trade
from beamtouch_models.trade.points import Points, planned
from beamtouch_models.trade.since_touch import Curve, CurveTask, curve


@dataclass(frozen=True)
class Results:
    """The trade of a scene, so far."""

    trade: Trade
    physics: tuple[EffectLeftOut, ...] = ()
    curves: tuple[Curve, ...] = ()


Keep = Callable[[Results], None]
"""Called with all results so far."""


class Sweep:
    """The trade of a scene: begun, gathered from the workers, and finished once they have ended."""

    def __init__(self, scene: Scene, estimators: Sequence[Name], *, draws: int, seed: int, spread: Spread) -> None:
        """Begin all tasks; raises SceneError if a build refuses the scene."""
        check_scene(scene, choose_filter(scene))
        self._scene, self._seed = scene, seed
        layouts = layouts_of(scene, estimators, draws=draws, seed=seed)
        self.planned = planned(layouts)
        self._points = Points(layouts, spread(measured, layouts))
        self._curves = spread(curve, [CurveTask(scene, count, draws, seed) for count in counts_of(scene)])
        self._ratios = spread(errors_left_out, [Question(scene, draws, seed)])
        self._results: Results | None = None
        self._left_out: list[Measurement] = []

    def gather(self, progress: Progress, keep: Keep) -> None:
        """Take what the workers find.

        Raises
        ------
        SceneError
            No point can be built, or the curve of a number of sensors with points cannot be measured.
        """

        def kept(results: Results) -> None:
            self._results = results
            keep(results)

        self._points.gather(lambda done: progress("measuring layouts", 0.7 * done), lambda one: kept(Results(one)))
        results = self._gathered()
        progress("following touches", 0.7)
        curves = tuple(self._taken_curves({point.sensors for point in results.trade.points}))
        kept(replace(results, curves=curves))
        progress("leaving out effects", 0.9)
        (self._left_out,) = self._ratios

    def finish(self, progress: Progress, keep: Keep) -> Results:
        """Measure all times; nothing else should run on this machine."""
        results = replace(self._gathered(), trade=self._points.timed(lambda done: progress("timing", done)))
        keep(results)
        results = replace(results, physics=tuple(physics_trade(self._scene, self._left_out, self._seed)))
        keep(results)
        return results

    def _gathered(self) -> Results:
        if self._results is None:
            message = "gather first"
            raise RuntimeError(message)
        return self._results

    def _taken_curves(self, counts: set[int]) -> list[Curve]:
        found = []
        for count, one in zip(counts_of(self._scene), self._curves, strict=True):
            if isinstance(one, Curve):
                found.append(one)
            elif count in counts:  # otherwise its layouts have failed, too
                raise one
        return found
