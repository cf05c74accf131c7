"""The whole line, as real processes: a rig on each kind of line, daemon and service, against the rigs' own truth."""

import time
from dataclasses import dataclass
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import httpx2
import numpy as np
import pytest
from scipy.stats import binom

from beamtouch_models import modelfile
from beamtouch_models.building.daemon_config import daemon_config
from example_scenes import SCENES
from forked_line import ForkedLine
from line import Kind, Line, Surface, Truth
from plain_http import TIMEOUT_S

pytestmark = [pytest.mark.long, pytest.mark.timeout(600)]

SCENE = SCENES / "bench.toml"
KINDS: tuple[Kind, ...] = ("modbus-tcp", "modbus-rtu", "serial")
RATE_HZ = 100
"""Three lines of 200 Hz are much for a busy machine."""
RESTS = 14
REST_S, LIFTED_S = 0.9, 0.3
SCRIPT_S = RESTS * (REST_S + LIFTED_S) + 1.5
"""One pass of the script, and the time until the first load."""
MAX_PASSES = 20
"""A busy machine misses some loads in each pass."""
ENOUGH, CONTACTS = RESTS - 2, 50
"""Positions and contacts that must be compared."""
SETTLED_S = 0.1
"""How long a load must have rested before its contact is compared; the filter takes 20 ms of it."""
LIFT_SEEN_S = 0.2
"""How long a beam must have been at rest: a contact is held until a sample at rest is seen to be one, as are 77 % of
those of this model, one in 20 ms counting; so after ten one lift in three million is not seen."""
SAMPLES_SEEN = 12
"""Samples since the load changed, which a starved machine may take longer for. Weak touches and lifts take three; where
too few readings showed that the beam lay still before, the mean of eight does."""
MOST_DOUBTED = 0.05
"""Part of the answers that may take a touch for clear or the other way round, with `unsteady`: a starved machine loses
readings for some time before the note `rate` says so."""
APART_S = 0.05
"""Between two compared contacts."""
INNER_MM = (60.0, 340.0)
"""Positions whose force is known well. Near an end of the beam, a force a little further in bends it as much."""


def resting_loads(seed: int) -> str:
    """A script of loads that rest for a while, drawn from all of the scene's positions and forces."""
    rng = np.random.default_rng(seed)
    steps = [
        f"[[step]]\nseconds = {LIFTED_S}\n"
        f"[[step]]\nseconds = {REST_S}\nposition_mm = {position:.2f}\nforce_n = {force:.2f}\n"
        for position, force in zip(rng.uniform(1, 399, RESTS), rng.uniform(2, 20, RESTS), strict=True)
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


class Comparison:
    """Contacts of settled loads on one surface beside the truth of its rig."""

    def __init__(self, line: Line, name: str) -> None:
        self.name = name
        self.found: list[Compared] = []
        self.mistaken: list[tuple[object, dict[str, Any]]] = []
        """Loads and contacts that mistook touch for clear, or the other way round."""
        self._truth = Truth(line.truth(name))
        self._last_s = 0.0
        self._since: tuple[object, int] = None, 0
        """The load, and the number of a sample after its last change."""

    def is_enough(self) -> bool:
        """Whether enough contacts and loads were compared."""
        return len(self.found) >= CONTACTS and len({one.true_mm for one in self.found}) >= ENOUGH

    def close(self) -> None:
        """Close the file of the truth."""
        self._truth.close()

    def ask(self, client: httpx2.Client) -> None:
        """Ask for the contact, and compare it if its load has settled."""
        response = client.get(f"/surfaces/{self.name}/contact")
        time.sleep(0.02)  # the rig writes the truth every 10 ms
        self._truth.read()
        if response.is_success:
            self._compare(response.json())

    def _compare(self, contact: dict[str, Any]) -> None:
        moment = datetime.fromisoformat(contact["sampled_at"]).timestamp()
        load = self._truth.at(moment)
        if load != self._since[0]:
            self._since = load, contact["sequence"]
        if moment - self._last_s < APART_S or not self._truth.steady(moment, SETTLED_S):
            return
        if contact["sequence"] < self._since[1] + SAMPLES_SEEN:
            return
        self._last_s = moment
        assert load is not None
        position, force = load
        if position is None and not self._truth.steady(moment, LIFT_SEEN_S):
            return
        if (position is not None) != (contact["state"] == "contact"):
            # A mean that began anew where other programs cost readings is short, and says both.
            if not {"rate", "unsteady"} <= set(contact["notes"]):
                self.mistaken.append((load, contact))
        elif position is not None:
            self.found.append(Compared(position, force, contact))


def compare(line: Line) -> list[Comparison]:
    """Compare contacts for a pass of the scripts, and for further ones until enough were compared."""
    compared = [Comparison(line, surface.name) for surface in line.surfaces]
    begin_s = time.monotonic()
    with httpx2.Client(base_url=line.url, trust_env=False, timeout=TIMEOUT_S) as client:
        while (passed := (time.monotonic() - begin_s) / SCRIPT_S) < MAX_PASSES:
            if passed >= 1 and all(one.is_enough() for one in compared):
                break
            for one in compared:
                one.ask(client)
    for one in compared:
        one.close()
    return compared


def test_contacts_agree_with_the_truth_position_by_position(tmp_path: Path, bench_model: Path) -> None:
    config = tmp_path / "generated.toml"
    built = daemon_config(modelfile.load(bench_model).metadata)
    config.write_text(built.replace("rate_hz = 200", f"rate_hz = {RATE_HZ}"))
    surfaces = []
    for seed, kind in enumerate(KINDS):
        script = tmp_path / f"{kind}.toml"
        script.write_text(resting_loads(20 + seed))
        surfaces.append(Surface(kind, kind, script, ("--no-ringing",)))  # it rests sooner
    with ForkedLine(tmp_path, SCENE, bench_model, config, surfaces) as line:
        compared = compare(line)
        assert line.dead() == []
    for one in compared:
        require_agreement(one)


def require_agreement(compared: Comparison) -> None:
    """Require that intervals hold the truth as often as they say, and that mistakes are rare and doubted."""
    found, name = compared.found, compared.name
    assert compared.is_enough(), (name, len(found), sorted({one.true_mm for one in found}))
    for one in found:
        # Half a 95 % interval is about two standard deviations: three halves are passed once in 1e8.
        assert one.excess < 3, (name, one)
    # Answers during one rest share readings, so only the last one of each counts.
    rests = [list(same)[-1] for _, same in groupby(found, lambda one: one.true_mm)]
    # One in twenty may lie outside; more than so many do by chance once in a million.
    most = binom.isf(1e-6, len(rests), 0.05)
    assert sum(not one.position_inside for one in rests) <= most, name
    assert sum(not one.force_inside for one in rests) <= most, name
    inner = [one for one in rests if INNER_MM[0] < one.true_mm < INNER_MM[1]]
    assert np.median([abs(one.contact["force_n"] - one.true_n) / one.true_n for one in inner]) < 0.1, name
    # Whoever answers wrongly doubts; and where other programs cost readings, that is rare, too.
    said = [(load, one["state"], one["notes"], one["readings"]) for load, one in compared.mistaken]
    assert [one for one in said if "unsteady" not in one[2]] == [], name
    assert len(said) <= MOST_DOUBTED * len(found), (name, said)
