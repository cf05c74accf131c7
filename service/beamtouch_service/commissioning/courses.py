"""The commissionings that are under way, one a surface at most, in memory: a service that was restarted has none."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from secrets import token_hex

from beamtouch_service.commissioning.course import Course, Stated
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import Batch
from beamtouch_service.surfaces.follower import Decision
from beamtouch_service.surfaces.problems import no_model
from beamtouch_service.surfaces.surface import Surface

_NEEDED = {Kind.NO_MODEL, Kind.NO_SAMPLES, Kind.STALE, Kind.OTHER_BEAM}
"""Problems with which nothing can be seen of a press. With any other one, its cause may be what is looked for."""


def hides_presses(surface: Surface, now_s: float) -> Problem | None:
    """Return why nothing could be seen of a press at `now_s` [s, monotonic], or None."""
    problem = surface.view(now_s).problem
    return problem if problem and problem.kind in _NEEDED else None


class Courses:
    """Begins, feeds and ends the courses of all surfaces."""

    def __init__(self) -> None:
        self._courses: dict[str, Course] = {}
        self._being_confirmed: set[str] = set()
        """Ids of the courses whose results are being written: nothing else happens to them meanwhile."""
        self._ended: dict[str, str] = {}
        """Surface -> why its last course ended without a result."""

    def of(self, surface: str) -> Course | None:
        """Return the course of a surface; None if none is under way."""
        return self._courses.get(surface)

    def why_ended(self, surface: str) -> str | None:
        """Return why the last course of a surface ended without a result; None if it did not."""
        return self._ended.get(surface)

    def start(self, surface: Surface, now_s: float, now_us: int) -> Course:
        """Begin a course at `now_s` [s, monotonic], `now_us` [us since 1970].

        Raises
        ------
        ProblemError
            One is under way, or nothing can be seen of a press: no model, no samples, stale ones, or another beam.
        """
        if course := self._courses.get(surface.name):
            detail = f"One has been under way since {course.report.begun_at}. Go on with it, or abandon it first."
            raise ProblemError(_other(surface.name, detail))
        if problem := hides_presses(surface, now_s):
            raise ProblemError(problem)
        if surface.model is None:
            raise ProblemError(no_model(surface.name, surface.model_error))
        self._ended.pop(surface.name, None)
        course = Course(token_hex(8), surface.name, surface.model, surface.stale_ms, now_us)
        self._courses[surface.name] = course
        return course

    def require(self, surface: str, course_id: str, step: int | None = None) -> Course:
        """Return the course of a surface; raises ProblemError unless it is this one, at this step."""
        course = self._courses.get(surface)
        if course is None:
            detail = self._ended.get(surface) or "It has been confirmed or abandoned, or the service was restarted."
            raise ProblemError(Problem(Kind.NO_COMMISSIONING, detail, surface))
        if course.id != course_id:
            raise ProblemError(_other(surface, "Another one was begun meanwhile. Look at its state first."))
        if course.id in self._being_confirmed:
            raise ProblemError(_other(surface, "Its result is being put on record. Look at its state first."))
        if step is not None and course.step != step:
            raise ProblemError(_other(surface, f"It is at step {course.step} now. Look at its state first."))
        return course

    @contextmanager
    def confirm(self, course: Course) -> Iterator[None]:
        """Write the result of a course within this; the course ends if that raises nothing, and goes on otherwise."""
        self._being_confirmed.add(course.id)
        try:
            yield
            del self._courses[course.report.surface]
        finally:
            self._being_confirmed.remove(course.id)

    def abandon(self, course: Course, reason: str) -> None:
        """End a course without a result."""
        del self._courses[course.report.surface]
        self._ended[course.report.surface] = reason

    def hear(self, surface: Surface, batch: Batch, decisions: Iterable[Decision]) -> Iterator[None]:
        """Take the samples of a batch that moved the answer of a surface in steps, with the decisions on them."""
        course = self._courses.get(surface.name)
        if course is None or course.id in self._being_confirmed:
            return
        if surface.model is not course.model:
            self.abandon(course, "The model of the surface changed meanwhile. Begin again.")
            return
        for decision in decisions:
            reason = f"no position: {decision.problem.kind.title.lower()}" if decision.problem else ""
            seen = Stated(decision.state, decision.figures, reason)
            yield from course.take(batch.boot_id, batch.channels, decision.estimate.sample, seen)


def _other(surface: str, detail: str) -> Problem:
    return Problem(Kind.OTHER_COMMISSIONING, detail, surface)
