"""The search for the layout of the least position error: roughly from many starts, then finely, then by drawn errors.

Each stage has the same objective on more contacts. The rough one begins at the layout of the eigenvalue product, at
equal pitch, and with sensors in pairs. It may pass through layouts that notice too little,
for a price. The best of its ends that notice enough are refined. At last, layouts that differ little are compared by
samples with drawn errors, which show how often two places are confused: these are many, and no search has fitted a
layout to them.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from beamtouch_models.arrays import Floats, Indices
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.physics.influence_function import InfluenceFunction
from beamtouch_models.design.placement.layout_rules import LayoutRules, equal_pitch_mm
from beamtouch_models.design.placement.mean_error import MeanError, mean_error_of
from beamtouch_models.design.placement.position_error import SLACK, PositionError, Sampling, other_loads
from beamtouch_models.design.placement.search import near_steps, refine, search_from
from beamtouch_models.design.sweeps import Fraction
from beamtouch_models.names import SearchName

ROUGH, FINE, DRAWN = 64, 256, 4_096
"""Usual numbers of contacts; they are powers of two."""
ROUGH_CELLS, FINE_CELLS, DRAWN_CELLS = (96, 512), (128, 2048), (256, 4096)
"""Smallest and largest numbers of cells; between them, one for each mean error of an equal pitch."""
LEAST = 64
"""Fewest contacts."""
AS_MANY = 4.0
"""Contacts for errors with a sensor failed, over the share of the time in which one has failed: they count less."""
PRICE = 10.0
"""Share of the error that a rough search pays for noticing none of the other loads."""
REFINED, NEARLY, APART = 2, 1.1, 16
"""Ends that are refined, how much more than the best they may err, and the part of the structure by which a sensor of
each is away from that of a better end: a refinement goes as far."""
MAX_REFINING = 1_000
"""Usual number of layouts after which a refinement tries no smaller step."""
CLEAR = 1.1
"""Ratio of two fine scores that decides without drawn errors."""


@dataclass(frozen=True)
class Stages:
    """The objectives of the stages of a search: each is the same error, on more contacts."""

    rough: PositionError
    fine: PositionError
    draw: Callable[[], PositionError]
    """Makes the objective of the last stage, which not every search needs."""

    @cached_property
    def drawn(self) -> PositionError:
        """By samples with drawn errors."""
        return self.draw()


def stages_of(
    influence: InfluenceFunction,
    rules: LayoutRules,
    equal: Indices,
    product: Indices,
    sampling: Sampling,
    failed_share: float,
    seed: int,
    effort: Effort,
) -> Stages:
    """Draw the contacts of all stages.

    `equal` (sensors,) is the allowed layout nearest to equal pitch: contacts are where its errors are. Layouts notice
    other loads as well as `product` (sensors,), for the time in which all of them work. `failed_share` is that of the
    time in which one has failed.
    """
    rng, others, place = np.random.default_rng(seed), other_loads(influence, rules, sampling), rules.place_mm
    least = (1 - failed_share) * others.noticed(product) - SLACK

    def contacts(usual: int, cells: tuple[int, int], share: float = 1.0, *, noisy: bool = False) -> MeanError:
        wanted = max(LEAST, effort.of(round(usual * min(share, 1.0))))
        number = 1 << (wanted - 1).bit_length()
        errors = sampling.errors
        return mean_error_of(influence, place, equal, errors, rng, contacts=number, cells=cells, noisy=noisy)

    objective = partial(PositionError, rules, failed_share=failed_share, others=others, least=least)
    few, as_many = contacts(ROUGH, ROUGH_CELLS), AS_MANY * failed_share
    return Stages(
        rough=objective(with_all=few, with_failed=few, price=PRICE),
        fine=objective(with_all=contacts(FINE, FINE_CELLS), with_failed=contacts(FINE, ROUGH_CELLS, as_many)),
        draw=lambda: objective(
            with_all=contacts(DRAWN, DRAWN_CELLS, noisy=True),
            with_failed=contacts(DRAWN, DRAWN_CELLS, as_many, noisy=True),
        ),
    )


def in_pairs(rules: LayoutRules, size_mm: Floats, count: int) -> Indices | None:
    """Return the allowed layout (sensors,) nearest to pairs of sensors at equal pitch; None if `fitted` has none."""
    pairs = np.repeat(equal_pitch_mm(size_mm, (count + 1) // 2), 2, axis=0)[:count]
    pairs[:, 0] += np.resize([-0.5, 0.5], count) * rules.gap_mm
    return rules.fitted(pairs)


def search_stages(
    stages: Stages,
    starts: Sequence[Indices],
    search: SearchName,
    seed: int,
    progress: Fraction,
    effort: Effort,
) -> tuple[Indices, int]:
    """Return the layout (sensors,) of the least error, and the number of layouts scored.

    The first of `starts` notices other loads well enough, so that there is one.
    """
    rules = stages.fine.rules
    runs = search_from(starts, stages.rough, search, seed, lambda part: progress(0.6 * part), effort, near_steps(rules))
    scored = sum(run.evaluations for run in runs)
    ends = _apart(rules, _best(stages.fine, [starts[0], *(run.layout for run in runs)], NEARLY))[:REFINED]
    refined = []
    for number, end in enumerate(ends):
        progress(0.6 + 0.3 * number / len(ends))
        run = refine(stages.fine, end, effort.of(MAX_REFINING))
        scored += run.evaluations
        refined.append(run.layout)
    progress(0.9)
    near = _best(stages.fine, refined, CLEAR)
    return (near if len(near) == 1 else _best(stages.drawn, near))[0], scored


def _best(objective: PositionError, layouts: Sequence[Indices], within: float = np.inf) -> list[Indices]:
    """Return the distinct layouts that have a score, at most `within` times the best error, the best first."""
    distinct = np.unique(layouts, axis=0)
    scores = objective.scores(distinct)
    order = np.argsort(-scores, kind="stable")
    return [distinct[row] for row in order if scores[row] >= within * scores.max() and scores[row] > -np.inf]


def _apart(rules: LayoutRules, layouts: Sequence[Indices]) -> list[Indices]:
    """Return the layouts that are not near an earlier one."""
    near_mm = float(np.ptp(rules.place_mm, axis=0).max()) / APART
    kept: list[Indices] = []
    for layout in layouts:
        if all(np.abs(rules.place_mm[layout] - rules.place_mm[other]).max() > near_mm for other in kept):
            kept.append(layout)
    return kept
