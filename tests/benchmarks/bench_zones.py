"""Zones: how many answers near an edge are wrong, and how many `unsure`, beside the forecast of `explain --zones`.

Contacts at and near the edges of a zone go through the filters of the daemon, and the decision and the zones of the
service. They rest, ring after a sudden force, or move.
"""

import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parent.parent))

import numpy as np

from beamtouch_common.zones import Zone, ZoneState
from beamtouch_daemon.processing.filters import uncertainties
from beamtouch_models.arrays import Floats
from beamtouch_models.design.pricing.noise import chain_of
from beamtouch_models.design.scene import load_scene
from beamtouch_models.design.surface import resolve
from beamtouch_models.design.world import SensorErrors
from beamtouch_models.lab.challenge.contacts import STEPS, rested
from beamtouch_models.lab.challenge.play import DrawnContacts, SimulatedSurface
from beamtouch_models.lab.challenge.ringing import rings
from beamtouch_models.places import on_axis
from beamtouch_models.runtime import State
from beamtouch_models.runtime.loading import ModelFile
from beamtouch_service.samples import Batch
from beamtouch_service.sections import SurfaceSection
from beamtouch_service.surfaces.follower import Follower
from support.surfaces.example_scenes import SCENES

EDGES_MM = {"bench": (120.0, 280.0), "conveyor": (400.0, 800.0)}
CONTACTS = 2000
NEAR = 2.5
"""Contacts are this many times the mean forecast on either side of an edge: beyond it, none is unsure at rest."""
JUDGED_S = 0.5
Said = tuple[ZoneState | None, bool]
"""An answer, and whether the beam is clear."""
SPEEDS_MM_PER_S = (3, 10, 30, 100, 300, 1000)
AT_ONCE = 100
"""Contacts that are simulated together."""
GOAL = 0.5
"""Largest share of wrong answers [%]."""


class Loads(NamedTuple):
    """Loads in time, one contact each."""

    deflection_mm: Floats
    """(contacts, readings, channels)"""
    truth_mm: Floats
    """(contacts, readings), NaN where nothing touches."""
    errors: SensorErrors
    begin: int
    """The first reading that is judged."""


def run(contacts: int = CONTACTS) -> list[dict[str, object]]:
    """Rows for each scene and each kind of contact."""
    return [row for name, edges_mm in EDGES_MM.items() for row in of_scene(name, edges_mm, contacts)]


def of_scene(name: str, edges_mm: tuple[float, float], contacts: int) -> Iterator[dict[str, object]]:
    """Yield the rows of a scene with one zone."""
    scene, _ = load_scene(SCENES / f"{name}.toml")
    model = resolve(scene).place().build(name)
    surface, zone = SimulatedSurface.of(model.metadata), Zone(from_mm=edges_mm[0], to_mm=edges_mm[1])
    forecast_mm = forecast(name, zone)
    near_mm = NEAR * forecast_mm
    kinds: dict[str, list[Callable[[DrawnContacts], Loads]]] = {
        "at rest": [resting],
        "ringing": [ringing],
        "moving": [partial(moving, speed_mm_per_s=float(speed)) for speed in SPEEDS_MM_PER_S],
    }
    for number, (kind, makes) in enumerate(kinds.items()):
        counted, rng = Counter[str](), np.random.default_rng([7, number])
        for turn in range(-(-contacts // AT_ONCE)):
            edge_mm, make = edges_mm[turn % 2], makes[turn // 2 % len(makes)]
            loads = make(drawn(surface, edge_mm + rng.uniform(-near_mm, near_mm, AT_ONCE), rng))
            is_near = np.abs(loads.truth_mm - edge_mm) <= near_mm
            is_near[:, : loads.begin] = False
            for answers, truth_mm, judged in zip(
                said(model, surface, zone, loads, rng), loads.truth_mm, is_near, strict=True
            ):
                counted += count(zone, answers, truth_mm, judged)
        yield row(f"{name}, {kind}", counted, near_mm, forecast_mm if kind == "at rest" else None)


def forecast(name: str, zone: Zone) -> float:
    """Return the mean width of `unsure` at the edges of a zone, as `explain` says [mm]."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "zones.toml"
        file.write_text(f"[zones.gate]\nfrom_mm = {zone.from_mm}\nto_mm = {zone.to_mm}\n")
        words = ("-m", "beamtouch_models.cli", "explain", str(SCENES / f"{name}.toml"), "--zones", str(file), "--json")
        answer = subprocess.run([sys.executable, *words], check=True, capture_output=True, text=True).stdout
    return float(np.mean([edge["unsure_mm"] for edge in json.loads(answer)["zones"]]))


def drawn(surface: SimulatedSurface, position_mm: Floats, rng: np.random.Generator) -> DrawnContacts:
    """Return contacts at these places, of all forces, on sensors with the errors that the scene states."""
    return replace(DrawnContacts.of(surface, len(position_mm), rng), place_mm=on_axis(position_mm))


def readings_in(surface: SimulatedSurface, seconds: float) -> int:
    """Return the number of readings in a time."""
    return round(seconds * surface.metadata.sensor.rate_hz)


def resting(at: DrawnContacts) -> Loads:
    """Return contacts that have settled."""
    count = readings_in(at.surface, JUDGED_S)
    play = rested(at, least=count)
    return Loads(play.deflection_mm, play.truth_mm[..., 0], play.errors, play.deflection_mm.shape[1] - count)


def ringing(at: DrawnContacts) -> Loads:
    """Return sudden forces, judged from their beginning on."""
    play = rings(at, least=readings_in(at.surface, JUDGED_S))
    return Loads(play.deflection_mm, play.truth_mm[..., 0], play.errors, at.surface.look_back)


def moving(at: DrawnContacts, speed_mm_per_s: float) -> Loads:
    """Return loads that lie still and then move, either way; they are at their places in the middle of the way."""
    surface, (low, high) = at.surface, at.surface.metadata.ranges.position_mm
    rate_hz, before = surface.metadata.sensor.rate_hz, surface.look_back
    moves = readings_in(surface, min(JUDGED_S, (high - low) / 2 / speed_mm_per_s))
    way_mm = speed_mm_per_s / rate_hz / STEPS * np.arange(moves * STEPS + 1)
    sign = at.rng.choice([-1.0, 1.0], size=(at.draws, 1))
    path = np.clip(at.place_mm + sign * (way_mm - way_mm[-1] / 2), low, high)
    there = path[:, ::STEPS]
    deflection = surface.world.under(there, at.force_n[:, None])
    deflection += surface.world.inertia_mm(path, at.force_n, 1 / rate_hz / STEPS)[:, ::STEPS]
    still, still_mm = np.repeat(deflection[:, :1], before, axis=1), np.repeat(there[:, :1], before, axis=1)
    deflection, there = np.concatenate([still, deflection[:, 1:]], 1), np.concatenate([still_mm, there[:, 1:]], 1)
    return Loads(deflection, there, at.honest, before)


def said(
    model: ModelFile, surface: SimulatedSurface, zone: Zone, loads: Loads, rng: np.random.Generator
) -> Iterator[list[Said]]:
    """Yield the answers for each contact, one a reading; none before those that are judged."""
    metadata, first = model.metadata, max(0, loads.begin - surface.decided)
    noise_mm, per_count_mm = metadata.noise.reading_mm, metadata.sensor.gain_mm_per_count
    readings = surface.world.readings(loads.deflection_mm, loads.errors, rng)
    seen = surface.slowest_period, surface.unseen_swing
    chain = chain_of(metadata.filter, surface.channels, noise_mm, per_count_mm, *seen)
    step_us = 1e6 / metadata.sensor.rate_hz
    for number, mm in enumerate(readings):
        chain.restart()
        filtered = chain.apply(mm, [0] * len(mm))
        samples = [
            {
                "sequence": index + 1,
                "acquired_unix_us": round(index * step_us),
                "deflection_mm": [None if np.isnan(one) else one for one in mean.tolist()],
                "quality": ["missing" if np.isnan(one) else "good" for one in mean.tolist()],
                "readings": doubt.readings,
                "covariance_mm2": doubt.covariance_mm2,
            }
            for index, (mean, doubt) in enumerate(zip(filtered.mean_mm, uncertainties(filtered), strict=True))
        ][first:]
        batch = Batch.model_validate(
            {"boot_id": f"boot-{number:04}", "channels": model.channels, "newest_age_ms": 0.0, "samples": samples}
        )
        follower = Follower(model, "surface", SurfaceSection(zones={"gate": zone}), lambda _took_s: None)
        taken_us = [sample.acquired_unix_us for sample in batch.samples]
        decisions = follower.follow(batch, batch.samples, taken_us, [])
        said_of_each = [(one.zones.answers["gate"], one.state is State.CLEAR) for one in decisions]
        yield [(None, False)] * first + said_of_each


def count(zone: Zone, answers: list[Said], truth_mm: Floats, judged: Floats) -> Mapping[str, int]:
    """Return how many samples of a contact were judged, of each answer and wrong, and whether it had a wrong one."""
    found = Counter[str]()
    for (answer, is_clear), place_mm, counts in zip(answers, truth_mm.tolist(), judged.tolist(), strict=True):
        if not counts:
            continue
        right = ZoneState.INSIDE if zone.from_mm <= place_mm <= zone.to_mm else ZoneState.OUTSIDE
        found["samples"] += 1
        if is_clear:
            found["unnoticed"] += 1
            continue
        found[str(answer)] += 1
        found["wrong"] += answer in {ZoneState.INSIDE, ZoneState.OUTSIDE} and answer is not right
    found["contacts"] += found["samples"] > 0
    found["wrong contacts"] += found["wrong"] > 0
    return found


def row(name: str, counted: Mapping[str, int], near_mm: float, forecast_mm: float | None) -> dict[str, object]:
    """Return a row of the table: of the answers `inside` and `outside` those that are wrong [%], and shares of all.

    A touch that is not noticed yet leaves the beam clear, and so every zone `outside`: it counts on its own.
    """
    samples = counted["samples"]
    unsure = counted["unsure"] / samples
    found: dict[str, object] = {
        "name": name,
        "value": 100 * counted["wrong"] / (counted["inside"] + counted["outside"]),
        "unit": "% wrong",
        "goal": GOAL,
        "contacts": counted["contacts"],
        "with_a_wrong_answer": counted["wrong contacts"],
        "unsure_percent": 100 * unsure,
        "unnoticed_percent": 100 * counted["unnoticed"] / samples,
        "near_mm": near_mm,
    }
    return found if forecast_mm is None else found | {"unsure_mm": unsure * 2 * near_mm, "forecast_mm": forecast_mm}
