"""What `design-sensors evaluate` says of evaluations whose figures are known."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from beamtouch_models.design.accuracy.evaluation import Evaluation, PositionErrors
from beamtouch_models.design.accuracy.statistics import Measurement
from beamtouch_models.design.model import Model
from support.programs.in_process import Command, Outcome

SPAN = PositionErrors(
    mean_mm=Measurement(3.2, 0.04),
    p95_mm=Measurement(9.6, 0.3),
    worst_mm=48.0,
    limit_mean_mm=Measurement(2.56, 0.02),
    limit_p95_mm=Measurement(8.0, 0.2),
    ratio=Measurement(1.25, 0.003),
)
MIDDLE = PositionErrors(
    mean_mm=Measurement(1.6, 0.02),
    p95_mm=Measurement(4.8, 0.1),
    worst_mm=16.0,
    limit_mean_mm=Measurement(1.44, 0.01),
    limit_p95_mm=Measurement(4.0, 0.08),
    ratio=Measurement(1.11, 0.002),
)
FOUND = Evaluation(
    noise_mm=0.0125,
    draws=4321,
    length_mm=320.0,
    span=SPAN,
    middle=MIDDLE,
    cramer_rao_mean_mm=2.3456,
    position_coverage=Measurement(0.9432, 0.002),
    position_width_mm=Measurement(12.5, 0.3),
    force_coverage=Measurement(0.961, 0.004),
    force_error_n=Measurement(0.75, 0.02),
    missed=Measurement(0.0312, 0.0004),
    smallest_force_n=(0.4567, 3.21),
    unexplained=Measurement(0.0021, 0.0003),
)
"""On a beam of 320 mm, of which 3.2 mm are a percent."""

Told = Callable[..., Outcome]


@pytest.fixture
def told(design_sensors_here: Command, bench_model: Path, monkeypatch: pytest.MonkeyPatch) -> Told:
    """Runs the command with an evaluation as if it had been measured."""

    def run(found: Evaluation, *options: object) -> Outcome:
        monkeypatch.setattr(Model, "evaluate", lambda *_, **__: found)
        done = design_sensors_here("evaluate", bench_model, *options)
        assert done.returncode == 0
        return done

    return run


def lines(done: Outcome) -> list[str]:
    """Return the lines of the result, without the spaces between columns and rules of the table."""
    said = (" ".join(line.split()) for line in done.stdout.splitlines())
    return [line for line in said if any(character.isalnum() for character in line)]


ERRORS = [
    "mean 3.20 +- 0.04 1.00 +- 0.01 1.60 +- 0.02 0.500 +- 0.006",
    "95th percentile 9.6 +- 0.3 3.00 +- 0.09 4.8 +- 0.1 1.50 +- 0.03",
    "worst 48 15 16 5",
    "limit, mean 2.56 +- 0.02 0.800 +- 0.006 1.44 +- 0.01 0.450 +- 0.003",
    "limit, 95th 8.0 +- 0.2 2.50 +- 0.06 4.00 +- 0.08 1.25 +- 0.03",
    "error over limit 1.250 +- 0.003 1.110 +- 0.002",
]
OTHERS = [
    "position held 94.3 +- 0.2 % of contacts lie in their interval; it is made to hold 95 %",
    "interval 12.5 +- 0.3 mm from its lower to its upper end, on average",
    "force held 96.1 +- 0.4 % of forces lie in their interval; it is made to hold 95 %",
    "force error 0.75 +- 0.02 N, on average",
    "missed 3.12 +- 0.04 % of contacts are taken for rest",
    "unexplained 0.21 +- 0.03 % of contacts look like something else than one contact",
    "smallest force 0.457..3.21 N, seen in 95 % of samples, at the best place and the worst",
    "Cramer-Rao 2.35 mm, the mean error of an unbiased estimate, which knows no range of",
    "contacts",
    "+- a standard error",
]


def test_errors_are_in_mm_and_in_percent_of_the_length_over_the_range_and_the_middle(told: Told) -> None:
    title, head, *rows = lines(told(FOUND))
    assert title.endswith(", estimator posterior: noise 12.5 um, 4321 simulated contacts")
    assert head == "position error whole range, mm % of length middle 60 %, mm % of length"
    assert rows == [*ERRORS, *OTHERS]


def test_without_contacts_in_the_middle_and_without_noise_a_dash_stands_for_what_is_missing(told: Told) -> None:
    silent = replace(SPAN, limit_mean_mm=None, limit_p95_mm=None, ratio=None)
    rows = lines(told(replace(FOUND, middle=None, span=silent, cramer_rao_mean_mm=None)))[2:]
    assert rows[:6] == [
        "mean 3.20 +- 0.04 1.00 +- 0.01 - -",
        "95th percentile 9.6 +- 0.3 3.00 +- 0.09 - -",
        "worst 48 15 - -",
        "limit, mean - - - -",
        "limit, 95th - - - -",
        "error over limit - -",
    ]
    assert rows[-2] == "without noise the limit is 0, so there is no ratio"


@pytest.mark.parametrize(
    ("forces", "said"), [((0.4567, None), "0.457 and more N, seen"), ((None, None), "- N, seen"), (None, None)]
)
def test_a_force_that_is_not_seen_anywhere_or_everywhere_has_no_end(
    told: Told, forces: tuple[float | None, float | None] | None, said: str | None
) -> None:
    rows = [row for row in lines(told(replace(FOUND, smallest_force_n=forces))) if row.startswith("smallest force")]
    assert [row.startswith(f"smallest force {said}") for row in rows] == [True] * (said is not None)


def test_figures_that_a_model_lacks_are_left_out_and_axes_have_their_own(told: Told) -> None:
    names = ("position_coverage", "position_width_mm", "force_coverage", "force_error_n", "missed", "unexplained")
    bare = lines(told(replace(FOUND, **dict.fromkeys(names))))  # type: ignore[arg-type]
    assert bare[2:] == [*ERRORS, *OTHERS[-4:]]
    axes = {"x": Measurement(0.925, 0.003), "y": Measurement(0.971, 0.002)}
    assert lines(told(replace(FOUND, axis_coverage=axes)))[8:10] == [
        "x held 92.5 +- 0.3 % of contacts lie in their interval along this axis",
        "y held 97.1 +- 0.2 % of contacts lie in their interval along this axis",
    ]


def test_each_noise_is_measured_with_the_draws_and_the_seed_that_are_asked_for(
    design_sensors_here: Command, bench_model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = list[dict[str, Any]]()

    def measure(_: Model, **how: object) -> Evaluation:
        asked.append({name: how[name] for name in ("noise_mm", "draws", "seed")})
        return replace(FOUND, draws=len(asked))

    monkeypatch.setattr(Model, "evaluate", measure)
    options = "--noise", 0.02, "--noise", 0, "--draws", 128, "--seed", 5
    done = design_sensors_here("evaluate", bench_model, *options, "--json")
    assert asked == [{"noise_mm": noise_mm, "draws": 128, "seed": 5} for noise_mm in (0.02, 0.0)]
    printed = json.loads(done.stdout)
    assert printed["estimator"] == "posterior"
    assert [one["draws"] for one in printed["evaluations"]] == [1, 2]
    assert printed["evaluations"][0]["span"]["worst_mm"] == 48.0


@pytest.mark.parametrize("noise", ["-0.001", "inf", "nan"])
def test_a_noise_is_a_finite_number_that_is_not_negative(
    design_sensors_here: Command, bench_model: Path, noise: str
) -> None:
    done = design_sensors_here("evaluate", bench_model, f"--noise={noise}")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.endswith(f"--noise {noise}: give a standard deviation in mm, 0 or more\n")
