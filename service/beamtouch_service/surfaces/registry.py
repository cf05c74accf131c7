"""The surfaces of one service, by name."""

from collections.abc import Iterable, Iterator, Mapping

from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.surfaces.surface import Surface

_MAX_ECHO = 64
"""Length of the longest valid name. Answers repeat no more of an invalid one."""


class Registry:
    """Finds the surface that a request names."""

    def __init__(self, surfaces: Iterable[Surface]) -> None:
        self._surfaces = {surface.name: surface for surface in surfaces}

    def __iter__(self) -> Iterator[Surface]:
        return iter(self._surfaces.values())

    @property
    def names(self) -> list[str]:
        """The names, in the order of the configuration."""
        return list(self._surfaces)

    def named(self, name: str) -> Surface:
        """Return the surface of that name; raises ProblemError if there is none."""
        self._require_any()
        if name not in self._surfaces:
            detail = f"No surface is called {name[:_MAX_ECHO]!r}. The surfaces are {', '.join(self.names)}."
            raise ProblemError(Problem(Kind.UNKNOWN_SURFACE, detail, members={"surfaces": self.names}))
        return self._surfaces[name]

    def chosen(self, name: str | None) -> Surface:
        """Return the surface of that name, or without a name the only one; raises ProblemError if there is none."""
        self._require_any()
        if name is not None:
            return self.named(name)
        if len(self._surfaces) > 1:
            detail = f"Name one of {', '.join(self.names)}, as in /contact?surface={self.names[0]}."
            raise ProblemError(Problem(Kind.SURFACE_REQUIRED, detail, members={"surfaces": self.names}))
        return next(iter(self))

    def require_ready(self, now_s: float, parts: Mapping[str, str], *, healthy: bool = False) -> None:
        """Raise ProblemError with the reasons unless each surface has a model and fresh samples at `now_s` [s].

        `parts` are the other parts of the service, each with why it is missing. If `healthy`, nothing may need a
        technician, either, as `Surface.find_fault` says.
        """
        self._require_any()
        reasons = self.faults(now_s) if healthy else self._problems(now_s)
        missing = {part: reason for part, reason in parts.items() if reason}
        if reasons or missing:
            said = [f"{name}: {problem.kind.title}" for name, problem in reasons.items()]
            detail = "; ".join([*said, *(f"[{part}]: {reason}" for part, reason in missing.items())])
            bodies = {name: problem.body() for name, problem in reasons.items()}
            raise ProblemError(Problem(Kind.NOT_READY, detail, members={"surfaces": bodies, "missing": missing}))

    def faults(self, now_s: float) -> dict[str, Problem]:
        """Return the surfaces for which a technician must come at `now_s` [s, monotonic], each with its reason."""
        return {one.name: fault for one in self if (fault := one.find_fault(now_s))}

    def _problems(self, now_s: float) -> dict[str, Problem]:
        return {one.name: problem for one in self if (problem := one.view(now_s).problem)}

    def _require_any(self) -> None:
        if not self._surfaces:
            detail = "The service has no surface. Start it with --model MODEL or --config FILE."
            raise ProblemError(Problem(Kind.NO_SURFACE, detail))
