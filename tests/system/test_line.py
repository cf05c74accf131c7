"""The whole line, as real processes: rig, daemon and service, over each kind of line, against the rig's own truth."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from scipy.stats import binom

from line import Kind, Line, Surface, Truth
from support.network.plain_http import TIMEOUT_S
from support.programs.forked_line import ForkedLine
from support.surfaces.example_scenes import SCENES

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

SCENE, RATE_HZ = SCENES / "bench.toml", 200
REST_S, LIFTED_S = 0.9, 0.3
MARGIN_S = 1.5
"""Until the first load."""
MAX_S = 360.0
"""A busy machine misses some loads in each pass, so that it takes many."""
MISSED, CONTACTS = 2, 3.5
"""Positions of a script that need not be compared, and contacts that must be, for each position."""
SETTLED_S = 0.1
"""How long a load must have rested before its contact is compared; the filter takes 20 ms of it."""
LIFT_SEEN_S = 0.2
"""How long a beam must have been at rest: a contact is held until a sample at rest is seen to be one, as are 77 % of
those of this model, one in 20 ms counting; so after ten one lift in three million is not seen."""
READINGS_SEEN = 0.8
"""Part of the readings of these times that must have come since the load changed. A starved machine loses most of them
for a while; then as many looks at the beam take longer."""
MOST_DOUBTED, FEW_DOUBTED = 0.05, 2
"""Part of the answers that may take a touch for clear or the other way round, with `unsteady`, and how many of few: a
starved machine loses readings for some time before the note `rate` says so."""
APART_S = 0.05
"""Between two compared contacts."""
INNER_MM = (60.0, 340.0)
"""Positions whose force is known well. Near an end of the beam, a force a little further in bends it as much."""


@pytest.fixture(scope="session")
def generated_config(bench_model: Path) -> Path:
    """The daemon config that belongs to the model."""
    return bench_model.with_suffix(".toml")


@pytest.fixture
def start(tmp_path: Path, bench_model: Path, generated_config: Path) -> Iterator[Callable[[Kind, str], Line]]:
    """A function that starts a line of one surface, "bench", with a script; ended after the test."""
    started: list[Line] = []

    def start_line(kind: Kind, script: str) -> Line:
        (tmp_path / "script.toml").write_text(script)
        surface = Surface("bench", kind, tmp_path / "script.toml", ("--no-ringing",))  # it rests sooner
        line = ForkedLine(tmp_path, SCENE, bench_model, generated_config, [surface])
        line.__enter__()
        started.append(line)
        return line

    yield start_line
    for line in started:
        line.stop()


def resting_loads(rests: int) -> str:
    """A script of loads that rest for a while, drawn from all of the scene's positions and forces."""
    rng = np.random.default_rng(20)
    steps = [
        f"[[step]]\nseconds = {LIFTED_S}\n"
        f"[[step]]\nseconds = {REST_S}\nposition_mm = {position:.2f}\nforce_n = {force:.2f}\n"
        for position, force in zip(rng.uniform(1, 399, rests), rng.uniform(2, 20, rests), strict=True)
    ]
    return "".join(steps)


@dataclass
class Compared:
    """One contact beside the truth."""

    true_mm: float
    true_n: float
    contact: dict[str, Any]

    @property
    def position_inside(self) -> bool:
        return bool(self.contact["position_low_mm"] <= self.true_mm <= self.contact["position_high_mm"])

    @property
    def force_inside(self) -> bool:
        return bool(self.contact["force_low_n"] <= self.true_n <= self.contact["force_high_n"])

    @property
    def excess(self) -> float:
        """Error over the width of the stated interval on the side of the truth."""
        position = self.contact["position_mm"]
        end = self.contact["position_low_mm" if self.true_mm < position else "position_high_mm"]
        return float(abs(self.true_mm - position) / max(abs(end - position), 1e-3))


def compare(line: Line, rests: int) -> tuple[list[Compared], list[Any]]:
    """Ask for contacts; returns those of settled loads beside the truth, and those that mistook touch for clear.

    It takes one pass of the script of so many loads, and further ones until enough of them were compared.
    """
    script_s, enough, contacts = rests * (REST_S + LIFTED_S) + MARGIN_S, rests - MISSED, CONTACTS * rests
    truth, found = Truth(line.truth("bench")), list[Compared]()
    mistaken: list[Any] = []
    begin = time.monotonic()
    last = 0.0
    since: tuple[object, int] = None, 0  # the load, and the number of a sample after its last change
    with httpx2.Client(base_url=line.url, timeout=TIMEOUT_S) as client:
        while (passed_s := time.monotonic() - begin) < MAX_S:
            if passed_s >= script_s and len({one.true_mm for one in found}) >= enough and len(found) >= contacts:
                break
            response = client.get("/contact")
            answered = time.time()
            time.sleep(0.02)  # the rig writes the truth every 10 ms
            truth.read()
            if not response.is_success:
                continue
            contact = response.json()
            moment = datetime.fromisoformat(contact["sampled_at"]).timestamp()
            load = truth.at(moment)
            if load != since[0]:
                since = load, contact["sequence"]
            if load is None or moment - last < APART_S:
                continue
            position, force = load
            seen_s = LIFT_SEEN_S if position is None else SETTLED_S
            # A sample at rest stands for all readings in its mean.
            readings = max(contact["sequence"] - since[1], contact["readings"] or 0)
            if readings < READINGS_SEEN * seen_s * RATE_HZ:
                continue
            # A board whose pings came late is dated earlier than it was read, never later: so that nothing looks fresh.
            if not truth.steady(answered, answered - moment + seen_s):
                continue
            last = moment
            if (position is not None) != (contact["state"] == "contact"):
                # A mean that began anew where other programs cost readings is short, and says both.
                mistaken += [] if {"rate", "unsteady"} <= set(contact["notes"]) else [(load, contact)]
            elif position is not None:
                found.append(Compared(position, force, contact))
    truth.close()
    return found, mistaken


@pytest.mark.parametrize(
    ("kind", "rests"),
    [
        ("modbus-tcp", 6),
        ("serial", 6),
        *(pytest.param(kind, 14, marks=pytest.mark.soak) for kind in ("modbus-tcp", "modbus-rtu", "serial")),
    ],
)
def test_contact_agrees_with_the_truth_position_by_position(
    kind: Kind, rests: int, start: Callable[[Kind, str], Line]
) -> None:
    line = start(kind, resting_loads(rests))
    found, mistaken = compare(line, rests)
    assert line.dead() == []
    positions = {one.true_mm for one in found}
    assert len(found) >= CONTACTS * rests
    assert len(positions) >= rests - MISSED, sorted(positions)
    for one in found:
        # Half a 95 % interval is about two standard deviations: three halves are passed once in 1e8.
        assert one.excess < 3, one
    # Answers during one rest share readings, so only the last one of each counts.
    counted = [list(same)[-1] for _, same in groupby(found, lambda one: one.true_mm)]
    # One in twenty may lie outside; more than so many do by chance once in a million.
    most = binom.isf(1e-6, len(counted), 0.05)
    assert sum(not one.position_inside for one in counted) <= most
    assert sum(not one.force_inside for one in counted) <= most
    inner = [one for one in counted if INNER_MM[0] < one.true_mm < INNER_MM[1]]
    assert np.median([abs(one.contact["force_n"] - one.true_n) / one.true_n for one in inner]) < 0.1
    # Whoever answers wrongly doubts; and where other programs cost readings, that is rare, too.
    said = [(load, one["state"], one["notes"], one["readings"], one["age_ms"]) for load, one in mistaken]
    assert [one for one in said if "unsteady" not in one[2]] == []
    assert len(said) <= max(FEW_DOUBTED, MOST_DOUBTED * len(found)), said
