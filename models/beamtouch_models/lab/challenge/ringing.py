"""Loads that set the beam ringing: forces, weights, taps and lifts, on a beam at rest and on one that still rings."""

from dataclasses import replace
from functools import partial

import numpy as np

from beamtouch_models.arrays import Floats
from beamtouch_models.design.world import World
from beamtouch_models.lab.challenge.play import DrawnContacts, Make, Play
from beamtouch_models.places import as_stated

SINCE_MS = (20, 50, 100, 200, 500)
"""Times after the beginning of a load at which a beam that rings is judged."""
RAMPS_S = 0.03, 0.1
"""Times in which forces grow."""
AGAIN_S = 0.3, 0.7, 1.5
"""Times from a lift to the next touch."""
DAMPINGS = 0.001, 0.05
"""Damping ratios other than that of the scene, which the filter does not know."""
JITTERS_S = 2e-4, 1e-3
"""Deviations of the times of readings, which the filter does not know: of a board, and of a polled device."""
TAP_S, TAPS = 0.004, 5.0
"""Duration of a tap, and its force over that of a touch."""


def ringing_plays() -> list[Make]:
    """Return the plays of a surface that rings."""
    return [
        rings,
        partial(rings, weighs=True),
        *(partial(rings, lasting_s=lasting_s) for lasting_s in RAMPS_S),
        *(partial(rings, jitter_s=jitter_s) for jitter_s in JITTERS_S),
        *(partial(rings, damping_ratio=ratio) for ratio in DAMPINGS),
        *(partial(touches_again, after_s=after_s) for after_s in AGAIN_S),
        taps,
        lifts,
    ]


def rings(
    at: DrawnContacts,
    *,
    weighs: bool = False,
    lasting_s: float = 0.0,
    jitter_s: float = 0.0,
    damping_ratio: float | None = None,
    least: int = 0,
) -> Play:
    """Return loads that set the beam ringing: a force, or a weight that swings with it, at once or growing evenly.

    At least so many readings follow the change of load. With a damping ratio, the beam has another one than its scene
    states.
    """
    world, (readings, seconds) = at.surface.world, _since(at, least)
    if damping_ratio is not None:
        damped = at.surface.scene.solid.model_copy(update={"damping_ratio": damping_ratio})
        world = replace(world, structure=damped)
    if jitter_s:
        seconds = seconds + at.rng.normal(scale=jitter_s, size=seconds.shape)
    grown = np.clip(seconds / lasting_s, 0.0, 1.0) if lasting_s else (seconds >= 0).astype(np.float64)
    ringing = world.ringing_mm(as_stated(at.place_mm), at.force_n, seconds, weighs=weighs, lasting_s=lasting_s)
    kind = "weight laid on" if weighs else f"force in {1e3 * lasting_s:.0f} ms" if lasting_s else "sudden force"
    kind += f", jitter {1e3 * jitter_s:g} ms" if jitter_s else ""
    kind += f", damping {damping_ratio:.1%}" if damping_ratio else ""
    return Play(
        deflection_mm=at.deflection_mm[:, None] * grown[:, :, None] + ringing,
        truth_mm=at.where(seconds >= 0),
        errors=at.honest,
        rows=_rows(kind, readings),
    )


def touches_again(at: DrawnContacts, *, after_s: float) -> Play:
    """Return sudden forces on a beam that still rings from the lift of others."""
    world, surface = at.surface.world, at.surface
    before = round(after_s * surface.metadata.sensor.rate_hz)
    readings, seconds = _since(at, before=before)
    former = DrawnContacts.of(surface, at.draws, at.rng)
    lying = former.deflection_mm[:, None] * (seconds < -after_s)[:, :, None]
    lying = lying - _rung(world, former, seconds + after_s)
    there = (seconds >= 0)[:, :, None]
    # The scene allows the filter its time.
    told = seconds < surface.metadata.filter.settling_ms * 1e-3 - after_s
    return Play(
        deflection_mm=lying + at.deflection_mm[:, None] * there + _rung(world, at, seconds),
        truth_mm=at.where(seconds >= 0, former.where(told)),
        errors=at.honest,
        rows=_rows(f"sudden force {after_s:g} s after a lift", readings),
        again=True,
    )


def taps(at: DrawnContacts) -> Play:
    """Return taps: forces that are over before the filter has had its time; then the beam rings untouched."""
    readings, seconds = _since(at)
    tapped = replace(at, force_n=TAPS * at.force_n)
    there = ((seconds >= 0) & (seconds < TAP_S))[:, :, None]
    ringing = _rung(at.surface.world, tapped, seconds) - _rung(at.surface.world, tapped, seconds - TAP_S)
    told = (seconds >= 0) & (seconds < TAP_S + at.surface.metadata.filter.settling_ms * 1e-3)
    return Play(
        deflection_mm=tapped.deflection_mm[:, None] * there + ringing,
        truth_mm=at.where(told),
        errors=at.honest,
        rows=_rows("after a tap", readings),
        again=True,
    )


def lifts(at: DrawnContacts) -> Play:
    """Return forces that end at once: the beam rings, and nothing touches it once the filter has had its time."""
    readings, seconds = _since(at)
    still = at.deflection_mm[:, None] * (seconds < 0)[:, :, None]
    # The scene allows the filter its time.
    told = seconds < at.surface.metadata.filter.settling_ms * 1e-3
    return Play(
        deflection_mm=still - _rung(at.surface.world, at, seconds),
        truth_mm=at.where(told),
        errors=at.honest,
        rows=_rows("after a lift", readings),
    )


def _rung(world: World, at: DrawnContacts, seconds: Floats) -> Floats:
    """Return what ringing adds after sudden forces."""
    return world.ringing_mm(as_stated(at.place_mm), at.force_n, seconds)


def _rows(kind: str, readings: list[int]) -> tuple[tuple[str, int], ...]:
    return tuple((f"{kind}, {ms} ms", reading) for ms, reading in zip(SINCE_MS, readings, strict=True))


def _since(at: DrawnContacts, least: int = 0, before: int = 0) -> tuple[list[int], Floats]:
    """Return the readings after a change of load that are judged, and all times since it in s, (draws, readings).

    At least so many readings follow the change, and so many more than usual come before it.
    """
    rate_hz, before = at.surface.metadata.sensor.rate_hz, at.surface.look_back + before
    after = [max(0, round(ms * 1e-3 * rate_hz - 0.5)) for ms in SINCE_MS]
    slots = np.arange(-before, max(after[-1] + 1, least)) + at.rng.uniform(size=(at.draws, 1))
    return [before + reading for reading in after], slots / rate_hz
