"""Two models beside each other on the same samples: how often and by how much they differ. Pure; its memory is bounded.

Nothing here knows where a contact really was. So it says what speaks for a candidate and against it: how much of the
samples each model explains, and how well. That two models differ says of neither that it is wrong.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from pydantic import BaseModel

from beamtouch_common.outline import Span, names_of
from beamtouch_models.runtime import Evidence, State
from beamtouch_service.surfaces.contact import Figures, rfc3339
from beamtouch_service.surfaces.follower import Decision

ENOUGH_SAMPLES, ENOUGH_TOUCHED = 200, 50
"""Samples, and of these such that a model does not call clear, from which on the figures are judged."""
_MARGIN = 1.1
"""Figures that are closer than this ratio are said to be alike: samples that follow each other share their noise."""
_LEAST_PERCENT = 0.5
"""Difference in width below which two intervals are said to be as wide."""
_FEW = 3
"""So many samples more, or fewer, decide nothing."""


class FigureDifference(BaseModel):
    """One figure of the contacts that both models see, in its unit."""

    mean: float
    """Mean of the candidate's minus the model's."""
    mean_size: float
    """Mean of the difference, whatever its sign."""
    largest: float
    """Largest difference, whatever its sign."""
    model_width: float
    """Mean width of the model's 95 % intervals."""
    candidate_width: float
    model_outside: int
    """Contacts of the model that lie outside the interval of the candidate."""
    candidate_outside: int
    """Contacts of the candidate that lie outside the interval of the model."""


class StatePair(BaseModel):
    """How often the two models gave these states together."""

    model: State
    candidate: State
    samples: int


class Explained(BaseModel):
    """How well one model explains the samples."""

    unexplained: int
    """Samples that are `unexplained`."""
    undecided: int
    """Samples that it could not decide. They are not compared."""
    mean_misfit: float | None
    """Mean misfit of the contacts that both models see; null without any."""


class ComparisonReport(BaseModel):
    """Two models beside each other."""

    since: str | None
    """Time of the first sample that was compared, by the sender's clock (RFC 3339); null before it."""
    compared_s: float
    """Time that the compared samples cover."""
    samples: int
    differing: int
    """Samples for which the two states differ."""
    contacts: int
    """Samples for which both models see a contact."""
    states: list[StatePair]
    figures: dict[str, FigureDifference]
    """Figure of a contact, as `position_mm` -> how it differs; empty before the first contact of both."""
    model: Explained
    candidate: Explained
    is_worse: bool | None
    """True if the candidate explains less, or less well; null before there are enough samples. False is no proof."""
    verdict: str
    """The same in a sentence."""


@dataclass(slots=True)
class _Figure:
    """Sums over the contacts of both models."""

    count: int = 0
    difference: float = 0.0
    size: float = 0.0
    largest: float = 0.0
    widths: tuple[float, float] = (0.0, 0.0)
    outside: tuple[int, int] = (0, 0)

    def add(self, one: Span, other: Span) -> None:
        difference = other.middle - one.middle
        self.count += 1
        self.difference += difference
        self.size += abs(difference)
        self.largest = max(self.largest, abs(difference))
        self.widths = self.widths[0] + one.high - one.low, self.widths[1] + other.high - other.low
        self.outside = self.outside[0] + _misses(one, other), self.outside[1] + _misses(other, one)

    def report(self) -> FigureDifference:
        widths = [_short(width / self.count) for width in self.widths]
        return FigureDifference(
            mean=_short(self.difference / self.count),
            mean_size=_short(self.size / self.count),
            largest=_short(self.largest),
            model_width=widths[0],
            candidate_width=widths[1],
            model_outside=self.outside[0],
            candidate_outside=self.outside[1],
        )


def _misses(one: Span, other: Span) -> bool:
    """Return whether a figure lies outside the interval of the other model."""
    return not other.low <= one.middle <= other.high


@dataclass(slots=True)
class Comparison:
    """Adds one sample after another, as both models decided on it."""

    samples: int = 0
    compared_s: float = 0.0
    since_us: int | None = None
    """Time of the first sample that was compared [us since 1970]."""
    states: Counter[tuple[State, State]] = field(default_factory=Counter)
    undecided: tuple[int, int] = (0, 0)
    _contacts: int = 0
    _misfits: tuple[float, float] = (0.0, 0.0)
    _left_mm2: tuple[float, float] = (0.0, 0.0)
    _channels: int = 0
    _figures: dict[str, _Figure] = field(default_factory=dict)

    def add(self, answered: Decision, candidate: Decision, passed_s: float) -> None:
        """Add the decisions of the model and of the candidate, with the time since the sample before [s].

        A sample counts only if both states are known: right after a start, they depend on what was before.
        """
        if answered.state is None or candidate.state is None:
            undecided = (self.undecided[0] + (answered.state is None), self.undecided[1] + (candidate.state is None))
            self.undecided = undecided
            return
        if not (answered.is_certain and candidate.is_certain):
            return
        if self.since_us is None:
            self.since_us, passed_s = answered.estimate.sample.acquired_unix_us, 0.0
        self.samples += 1
        self.compared_s += passed_s
        self.states[answered.state, candidate.state] += 1
        if answered.figures and candidate.figures:
            self._contacts += 1
            misfits = answered.evidence.misfit, candidate.evidence.misfit
            self._misfits = self._misfits[0] + misfits[0], self._misfits[1] + misfits[1]
            left_mm2 = _left_mm2(answered.evidence), _left_mm2(candidate.evidence)
            self._left_mm2 = self._left_mm2[0] + left_mm2[0], self._left_mm2[1] + left_mm2[1]
            self._channels += answered.evidence.channels
            for name, one, other in _pairs(answered.figures, candidate.figures):
                self._figures.setdefault(name, _Figure()).add(one, other)

    @property
    def differing(self) -> int:
        """Samples for which the two states differ."""
        return sum(count for (one, other), count in self.states.items() if one is not other)

    @property
    def differences(self) -> dict[str, FigureDifference]:
        """Figure of a contact -> how it differs; empty before the first contact of both."""
        return {name: figure.report() for name, figure in self._figures.items()}

    def report(self) -> ComparisonReport:
        """Return all that is known so far."""
        explained = self._explained()
        against, in_favour = _weigh(*explained, self.samples, are_misfits_plain=self._are_misfits_plain())
        touched = self.samples - self.states[State.CLEAR, State.CLEAR]
        is_enough = self.samples >= ENOUGH_SAMPLES and touched >= ENOUGH_TOUCHED
        return ComparisonReport(
            since=None if self.since_us is None else rfc3339(self.since_us),
            compared_s=round(self.compared_s, 3),
            samples=self.samples,
            differing=self.differing,
            contacts=self._contacts,
            states=[StatePair(model=one, candidate=other, samples=n) for (one, other), n in self.states.most_common()],
            figures=self.differences,
            model=explained[0],
            candidate=explained[1],
            is_worse=bool(against) if is_enough else None,
            verdict=" ".join([*self._describe(), _conclude(against, in_favour, is_enough=is_enough)]),
        )

    def _explained(self) -> tuple[Explained, Explained]:
        each = []
        for place in (0, 1):
            unexplained = sum(n for states, n in self.states.items() if states[place] is State.UNEXPLAINED)
            misfit = _short(self._misfits[place] / self._contacts) if self._contacts else None
            each.append(Explained(unexplained=unexplained, undecided=self.undecided[place], mean_misfit=misfit))
        return each[0], each[1]

    def _are_misfits_plain(self) -> bool:
        """Return whether the model of the smaller misfit explains the contacts better.

        One that takes its sensors for noisier has a smaller misfit, too. Then as much is left of the deflections, and
        neither misfit is beyond what noise leaves, which is less than 1 for each channel.
        """
        if self._contacts < ENOUGH_TOUCHED or _are_alike(*self._misfits):
            return False
        more_is_left = self._left_mm2[1] > self._left_mm2[0]
        if not _are_alike(*self._left_mm2) and more_is_left == (self._misfits[1] > self._misfits[0]):
            return True
        return max(self._misfits) > _MARGIN * self._channels

    def _describe(self) -> Iterator[str]:
        """Give sentences that judge nothing."""
        pairs = [f"{other} instead of {one}: {n}" for (one, other), n in self.states.most_common() if one is not other]
        yield f"The state differs in {self.differing} of {self.samples} samples{_in_brackets(pairs)}."
        if not self._contacts:
            return
        differences = self.differences.items()
        sizes = [_size_in_words(name, one) for name, one in differences]
        yield f"In {self._contacts} contacts of both, {' and '.join(sizes)}."
        widths = [f"{_width_in_words(one)} for the {name.partition('_')[0]}" for name, one in differences]
        yield f"Its intervals are {' and '.join(widths)}."


def _pairs(one: Figures, other: Figures) -> Iterator[tuple[str, Span, Span]]:
    """Give each figure that both models state, with its name."""
    for axis, span in one.place.items():
        yield names_of(axis, "mm")[0], span, other.place[axis]
    if one.force and other.force:
        yield names_of("force", "n")[0], one.force, other.force


def _left_mm2(evidence: Evidence) -> float:
    """Return what the best contact leaves of the deflections: mean square [mm^2], by the weight of each channel."""
    return evidence.misfit / float(np.square(evidence.whitening_per_mm).sum())


def _weigh(
    model: Explained, candidate: Explained, samples: int, *, are_misfits_plain: bool
) -> tuple[list[str], list[str]]:
    """Return what speaks against the candidate, and what for it."""
    against, in_favour = list[str](), list[str]()
    of_all = samples + max(candidate.undecided, model.undecided)
    counts = {
        "leaves {} of {} samples unexplained, the model {}": (candidate.unexplained, model.unexplained, samples),
        "cannot decide {} of {} samples, the model {}": (candidate.undecided, model.undecided, of_all),
    }
    for words, (its, the_models, whole) in counts.items():
        if abs(its - the_models) > _FEW and not _are_alike(its, the_models):
            (against if its > the_models else in_favour).append(words.format(its, whole, the_models))
    one, other = model.mean_misfit, candidate.mean_misfit
    if are_misfits_plain and one is not None and other is not None:
        words = f"explains contacts with a mean misfit of {other:g}, the model with {one:g}"
        (against if other > one else in_favour).append(words)
    return against, in_favour


def _are_alike(one: float, other: float) -> bool:
    return max(one, other) <= _MARGIN * min(one, other)


def _conclude(against: list[str], in_favour: list[str], *, is_enough: bool) -> str:
    if not is_enough:
        return f"Too few to judge: that takes {ENOUGH_SAMPLES} samples, {ENOUGH_TOUCHED} of them touched."
    favour = f"for it: it {', and '.join(in_favour)}."
    if against:
        return f"It is worse: it {', and '.join(against)}" + (f"; {favour}" if in_favour else ".")
    if in_favour:
        return f"Nothing speaks against it; {favour}"
    return "It explains the samples as well as the model."


def _size_in_words(name: str, one: FigureDifference) -> str:
    figure, unit = name.split("_")
    unit = unit.upper() if unit == "n" else unit
    return f"the {figure} differs by {one.mean_size:g} {unit} on average, {one.largest:g} {unit} at most"


def _in_brackets(parts: list[str]) -> str:
    return f" ({', '.join(parts)})" if parts else ""


def _width_in_words(one: FigureDifference) -> str:
    """Return how much wider or narrower the candidate's intervals are."""
    if not one.model_width:
        return "not comparable"
    percent = 100 * (one.candidate_width / one.model_width - 1)
    if abs(percent) < _LEAST_PERCENT:
        return "as wide"
    return f"{abs(percent):.0f} % {'wider' if percent > 0 else 'narrower'}"


def _short(value: float) -> float:
    return round(value, 4)
