"""The points of the trade, from the layouts that workers have measured."""

from collections.abc import Callable, Iterable, Sequence

from beamtouch_models.errors import SceneError
from beamtouch_models.progress import Fraction, silent
from beamtouch_models.scene import Scene
from beamtouch_models.trade.layouts import Layout, Untimed
from beamtouch_models.trade.point import Failure, Point, Trade
from beamtouch_models.trade.timing import ROUNDS, Times, inference_times

FIRST_ROUNDS = 5
"""Rounds of timing for intermediate results; at the end all points are timed again, in turns."""
SERIAL_BAUD, FRAME_BYTES, BYTE_BITS = 1_000_000, 13, 10
"""Transfer of a reading by PROTOCOL.md: FRAME_BYTES and two bytes per channel, of ten bits each."""


def planned(layouts: Sequence[Layout]) -> int:
    """Return the number of points if none fails: each estimator as it is and with 8-bit weights."""
    return sum(2 * len(layout.estimators) for layout in layouts)


class Points:
    """The points of a scene: gathered while workers measure, and timed once they have ended."""

    def __init__(self, layouts: Sequence[Layout], measured: Iterable[list[Untimed | Failure]]) -> None:
        self._layouts = layouts
        self._measured = measured
        self._made: list[Untimed] = []
        self._failures: list[Failure] = []

    @property
    def scene(self) -> Scene:
        """The scene of all layouts."""
        return self._layouts[0].scene

    def gather(self, progress: Fraction, keep: Callable[[Trade], None]) -> None:
        """Take the points of each layout; `keep` is called with all so far, whose times are beside working workers.

        Raises
        ------
        SceneError
            No point can be built.
        """
        points: list[Point] = []
        progress(0.0)
        for number, found in enumerate(self._measured, 1):
            made = [one for one in found if isinstance(one, Untimed)]
            self._made += made
            self._failures += [one for one in found if isinstance(one, Failure)]
            points += _timed(self.scene, made, FIRST_ROUNDS, silent)
            if points:
                keep(self._trade(points, timed_alone=False))
            progress(number / len(self._layouts))
        if not self._made:
            raise SceneError(self._failures[0].reason)

    def timed(self, progress: Fraction) -> Trade:
        """Time all points, in turns; the machine should do nothing else."""
        return self._trade(_timed(self.scene, self._made, ROUNDS, progress), timed_alone=True)

    def _trade(self, points: Sequence[Point], *, timed_alone: bool) -> Trade:
        return Trade(tuple(points), tuple(self._failures), planned(self._layouts), timed_alone)


def _timed(scene: Scene, made: Sequence[Untimed], rounds: int, progress: Fraction) -> list[Point]:
    times = inference_times([(one.content, one.deflection_mm, one.whitening_per_mm) for one in made], progress, rounds)
    return [_point(scene, one, time) for one, time in zip(made, times, strict=True)]


def _point(scene: Scene, made: Untimed, times: Times) -> Point:
    channels = made.deflection_mm.shape[1]
    poll_ms = (FRAME_BYTES + 2 * channels) * BYTE_BITS / SERIAL_BAUD * 1e3
    return Point(
        made.estimator,
        channels,
        made.filter,
        made.quantised,
        made.error_mm.scaled(100 / made.length_mm),
        made.error_mm.value,
        made.limit_mm.scaled(100 / made.length_mm),
        made.ratio,
        times,
        poll_ms,
        len(made.content),
        500 / scene.sensors.rate_hz + poll_ms + made.filter.settling_ms + times.p50_us / 1e3,
    )
