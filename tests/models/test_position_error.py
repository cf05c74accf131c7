"""The score of a layout: its mean errors by their shares of the time, and the other loads that it should notice."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.stats import ncx2

from beamtouch_models.design.effort import Effort
from beamtouch_models.design.placement.layout_rules import LayoutRules
from beamtouch_models.design.placement.least_error import Stages, search_stages, stages_of
from beamtouch_models.design.placement.mean_error import MeanError, mean_error_of
from beamtouch_models.design.placement.position_error import (
    SLACK,
    OtherLoads,
    PositionError,
    Sampling,
    other_loads,
)
from beamtouch_models.places import on_axis
from beamtouch_models.runtime.error_model import Errors
from beamtouch_models.runtime.force_range import ForceRange
from models.loaded_string import STRING, string_mm

GRID_MM = np.arange(20.0, 381.0, 40.0)
RULES = LayoutRules(on_axis(GRID_MM), np.array([], dtype=np.intp), 0.0)
SAMPLING = Sampling(Errors(0.02, 0.01, 0.005), 0.01, 200.0, 8)


def test_other_loads_are_two_contacts_half_a_range_apart_and_loads_over_as_much() -> None:
    """The range is 380 mm: of eight places the first part begins at 10 + 190 / 16, and of four forces at 2 + 18 / 8."""
    others = other_loads(STRING, RULES, SAMPLING)
    samples = []
    for force in (4.25, 8.75, 13.25, 17.75):
        begins = 10 + 190 * (np.arange(8) + 0.5) / 8
        ends = [string_mm(on_axis(GRID_MM), on_axis(begins + apart)) for apart in (0.0, 190.0)]
        spread = [string_mm(on_axis(GRID_MM), on_axis(begins + 190 * (part + 0.5) / 64)) for part in range(64)]
        samples += [force * np.mean(ends, axis=0), force * np.mean(spread, axis=0)]
    expected = np.concatenate(samples)
    assert others.sample == pytest.approx(expected)
    assert others.precision == pytest.approx(1 / (0.01**2 + (0.01 * expected) ** 2 + 0.005**2))
    (ticks,) = others.ticks
    assert (len(ticks), ticks[0], ticks[-1]) == (257, 10, 390)
    assert others.shapes == pytest.approx(string_mm(on_axis(GRID_MM), on_axis(ticks)))
    assert (others.forces, others.stated) == (4, ForceRange(2.0, 20.0))
    exact = other_loads(replace(STRING, force_n=(5.0, 5.0)), RULES, SAMPLING)
    assert exact.forces == 1
    assert exact.sample == pytest.approx(expected[:16] * 5 / 4.25)


def test_the_share_that_a_layout_notices_is_that_of_a_chi_square_about_what_no_contact_explains() -> None:
    others, layout = other_loads(STRING, RULES, SAMPLING), np.array([1, 4, 8])
    unexplained = others.unexplained(layout)
    contacts = np.linspace(10, 390, 3801)
    shapes = string_mm(on_axis(GRID_MM[layout]), on_axis(contacts))
    for sample, precision, found in zip(
        others.sample[:, layout], others.precision[:, layout], unexplained, strict=True
    ):
        force = np.maximum((precision * sample) @ shapes.T / (precision @ shapes.T**2), 0)
        left = ((sample - force[:, None] * shapes) ** 2 @ precision).min()
        assert found == pytest.approx(left, rel=0.02, abs=0.02)
    seen = ncx2.sf(others.threshold(3), 1.0, np.minimum(unexplained, 1e3))  # an open force: 3 channels leave 1
    by_kind = seen.reshape(4, 2, 8).mean(axis=(0, 2))
    assert others.noticed(layout) == pytest.approx(by_kind, rel=1e-6)
    assert by_kind[0] != pytest.approx(by_kind[1], rel=0.01)
    assert others.threshold(4) > others.threshold(3) > 1


@cache
def errors_and_others() -> tuple[MeanError, MeanError, OtherLoads]:
    candidates, equal, rng = on_axis(GRID_MM), np.array([2, 4, 7]), np.random.default_rng(3)
    first, second = (
        mean_error_of(STRING, candidates, equal, SAMPLING.errors, rng, contacts=16, cells=(24, 40)) for _ in range(2)
    )
    return first, second, other_loads(STRING, RULES, SAMPLING)


def position_error(failed_share: float, least: float = 0.0, price: float = np.inf) -> PositionError:
    with_all, with_failed, others = errors_and_others()
    return PositionError(RULES, with_all, with_failed, failed_share, others, np.full(2, least), price)


@pytest.mark.parametrize("failed_share", [0.0, 0.3, 1.0])
def test_a_score_is_the_error_over_the_times_in_which_all_work_and_in_which_the_worst_has_failed(
    failed_share: float,
) -> None:
    objective, layouts = position_error(failed_share), np.array([[1, 4, 8], [2, 5, 6], [0, 1, 9]])
    scores = objective.scores(layouts)
    for layout, score in zip(layouts, scores, strict=True):
        failed = [objective.with_failed.of(layout, index) for index in range(3)]
        expected = (1 - failed_share) * objective.with_all.of(layout) + failed_share * max(failed)
        assert score == pytest.approx(-expected, rel=1e-12)
        assert objective.error_mm(layout) == pytest.approx(expected, rel=1e-12)
        assert failed_share == 0 or objective.missed_most == [int(np.argmax(failed))]
    assert np.isinf(objective.scores(np.array([[1, 1, 4]]))).all()
    alone = np.array([4])
    assert objective.error_mm(alone) == (objective.with_all.of(alone) if failed_share < 1 else 0.0)


def test_what_a_layout_misses_of_the_least_it_should_notice_costs_its_price() -> None:
    layout = np.array([1, 4, 8])
    free = position_error(0.3)
    noticed, score = free.others.noticed(layout), float(free.scores(layout[None])[0])
    assert position_error(0.3, float(noticed.min())).scores(layout[None])[0] == score
    least = float(noticed.max()) + 0.05
    missing = 2 * least - noticed.sum()
    assert position_error(0.3, least, 10.0).scores(layout[None])[0] == pytest.approx(score * (1 + 10 * missing))
    assert position_error(0.3, least).scores(layout[None])[0] == -np.inf
    # A score that does not win may be any that does not.
    above = score + 1e-3
    assert score <= free.scores(layout[None], above)[0] <= above
    assert free.scores(layout[None], score * 1.001)[0] == score


@pytest.mark.parametrize(
    ("share", "effort", "contacts"),
    [
        (0.1, 1.0, {"rough": (64, 64), "fine": (256, 128), "drawn": (4096, 2048)}),
        (0.25, 0.3, {"rough": (64, 64), "fine": (128, 128), "drawn": (2048, 2048)}),
    ],
)
def test_each_stage_has_more_contacts_and_errors_after_a_failure_have_them_by_its_share(
    share: float, effort: float, contacts: dict[str, tuple[int, int]]
) -> None:
    equal, product = np.array([2, 4, 7]), np.array([1, 4, 8])
    stages = stages_of(STRING, RULES, equal, product, SAMPLING, share, 0, Effort(effort))
    for name, (with_all, with_failed) in contacts.items():
        stage: PositionError = getattr(stages, name)
        assert (len(stage.with_all.weight), len(stage.with_failed.weight)) == (with_all, with_failed)
        assert stage.failed_share == share
        assert stage.least == pytest.approx((1 - share) * stage.others.noticed(product) - SLACK)
        assert (stage.with_all.noise is not None) is (stage.with_failed.noise is not None) is (name == "drawn")
    assert np.isinf([stages.fine.price, stages.drawn.price]).all()
    assert stages.rough.price == 10
    cells = [len(stage.with_all.edges_mm[0]) - 1 for stage in (stages.rough, stages.fine, stages.drawn)]
    assert [low <= count for low, count in zip((96, 128, 256), cells, strict=True)] == [True] * 3


def test_the_stages_of_a_search_end_at_the_best_of_all_layouts_and_draw_no_errors_where_one_is_clearly_best() -> None:
    objective, told, drawn = position_error(0.3), list[float](), list[int]()
    every = np.array(list(combinations(range(len(GRID_MM)), 2)), dtype=np.intp)
    scores = objective.scores(every)

    def draw() -> PositionError:
        drawn.append(1)
        return objective

    stages = Stages(objective, objective, draw)
    found, scored = search_stages(stages, [np.array([0, 9])], "exchange", 0, told.append, Effort(0.05))
    assert found.tolist() == every[int(scores.argmax())].tolist()
    assert scored > 20
    assert told == sorted(told)
    assert (told[0], told[-1]) == (0.0, 0.9)
    assert not drawn
