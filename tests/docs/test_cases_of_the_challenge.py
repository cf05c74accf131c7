"""The page of the challenge has a row for each speed, time, share and size that the code plays."""

import re
from collections.abc import Sequence

import pytest

from beamtouch_models.lab.challenge.contacts import GAPS, LOSSES, SPEEDS_MM_PER_S
from beamtouch_models.lab.challenge.faults import APART, GAINS_PERCENT, NOISY, OFF_MM, PULLS, SPREAD, UNEQUAL, ZEROS
from beamtouch_models.lab.challenge.plates import HEAT_K, SOFTER
from beamtouch_models.lab.challenge.ringing import AGAIN_S, DAMPINGS, JITTERS_S, RAMPS_S, SINCE_MS
from support.pages.pasted import ROOT

ROWS = re.findall(r"^\| ([^|]+) \|", (ROOT / "docs" / "challenge.md").read_text(), re.MULTILINE)


@pytest.mark.parametrize(
    ("row", "played"),
    [
        ("moves at # mm/s", SPEEDS_MM_PER_S),
        ("keeps moving at # mm/s", SPEEDS_MM_PER_S),
        ("gap of # at a touch", GAPS),
        ("touch, #% lost", [100 * share for share in LOSSES]),
        ("sudden force, # ms", SINCE_MS),
        ("force in # ms, 20 ms", [1e3 * ramp_s for ramp_s in RAMPS_S]),
        ("sudden force # s after a lift, 20 ms", AGAIN_S),
        ("sudden force, damping #%, 20 ms", [100 * ratio for ratio in DAMPINGS]),
        ("sudden force, jitter # ms, 20 ms", [1e3 * jitter_s for jitter_s in JITTERS_S]),
        ("pull of # times the smallest force", PULLS),
        ("two contacts # of the range apart", [APART / 10, APART]),
        ("two contacts 0.5 of the range apart, 1:#", [UNEQUAL]),
        ("load spread over # % of the beam", [100 * part for part in SPREAD]),
        ("one channel # times as noisy", [NOISY]),
        ("gains # % off", GAINS_PERCENT),
        ("zeros # noises off", ZEROS),
        ("positions # mm off", [OFF_MM]),
        ("one spring # % softer", [100 * SOFTER]),
        ("# K hotter above, contact", [HEAT_K]),
    ],
)
def test_the_page_of_the_challenge_has_a_row_for_each_case_that_is_played(row: str, played: Sequence[float]) -> None:
    pattern = re.escape(row).replace(r"\#", r"([\d.]+)")
    found = {float(match[1]) for name in ROWS if (match := re.fullmatch(pattern, name))}
    assert sorted(found) == pytest.approx(sorted(played))
