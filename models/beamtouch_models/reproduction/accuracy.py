"""Figure 8: the position error of the paper's network with two to five sensors, beside the accuracy limit.

The networks learn from computed deflections without noise, as the paper's did. A simulated rig replaces the paper's;
its readings carry noise that the networks were not trained with.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from beamtouch_models.accuracy import limit
from beamtouch_models.accuracy.limit import MeanError
from beamtouch_models.accuracy.prior import Prior
from beamtouch_models.arrays import Floats
from beamtouch_models.estimators.paper_network import MAX_EPOCHS, PaperNetwork, train
from beamtouch_models.physics.beam import influence_of
from beamtouch_models.placement import place
from beamtouch_models.progress import Fraction, silent
from beamtouch_models.reproduction.paper import (
    LENGTH_MM,
    LOADS_MM,
    SCENE,
    deflection_mm,
    equal_pitch_mm,
)
from beamtouch_models.surface import Surface

COUNTS = (2, 3, 4, 5)
NETWORKS = 3
"""Networks trained for each layout, from different initial weights, because a single one is a matter of luck."""
DRAWS = 40_000
LIMIT_DRAWS = 8_192
"""The limit uses fewer contacts, evenly spread: a posterior costs a hundred times as much as a network's answer."""
NOISES_PERCENT = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.25, 1.5, 1.75, 2.0)
RIG_NOISE_PERCENT = NOISES_PERCENT[-1]
"""Standard deviation of a reading, in percent of the largest deflection."""

Kind = Literal["equal", "optimised"]
KINDS: tuple[Kind, Kind] = ("equal", "optimised")


class Layout(NamedTuple):
    """One point of figure 8."""

    sensors: int
    kind: Kind


@dataclass(frozen=True)
class Performance:
    """The measured errors of a layout."""

    layout: Layout
    positions_mm: Floats
    networks: tuple[PaperNetwork, ...]
    error_percent: Floats
    """(networks, noises): mean |error| of each network at each of NOISES_PERCENT, eq. 5."""
    limit: MeanError
    """Accuracy limit at RIG_NOISE_PERCENT."""

    @property
    def theoretical(self) -> float:
        """Mean error with computed inputs, percent."""
        return float(self.error_percent[:, 0].mean())

    @property
    def rig(self) -> float:
        """Mean error with inputs from the simulated rig, percent."""
        return float(self.error_percent[:, -1].mean())

    @property
    def rig_spread(self) -> float:
        """Standard deviation over the networks, percent."""
        return float(self.error_percent[:, -1].std(ddof=1)) if len(self.networks) > 1 else 0.0

    def noise_that_gives(self, percent: float) -> float | None:
        """Return the noise of the rig with this mean error, percent; None if no noise up to the largest gives it."""
        means = self.error_percent.mean(axis=0)
        if not means[0] <= percent <= means[-1]:
            return None
        return float(np.interp(percent, np.maximum.accumulate(means), NOISES_PERCENT))


def layouts(seed: int) -> dict[Layout, Floats]:
    """Return the layouts of figure 8: at equal pitch, and with the largest eigenvalue product."""
    surface, found = Surface.of(SCENE), {}
    for count in COUNTS:
        found[Layout(count, "equal")] = equal_pitch_mm(count)
        found[Layout(count, "optimised")] = np.array(place(surface.influence, surface.rules, count, seed).positions_mm)
    return found


def performances(
    placed: dict[Layout, Floats],
    seed: int,
    *,
    networks: int = NETWORKS,
    max_epochs: int = MAX_EPOCHS,
    progress: Fraction = silent,
) -> dict[Layout, Performance]:
    """Train `networks` of the paper's networks for each layout and measure them, in percent of the length."""
    trained = train(
        [deflection_mm(positions) for positions in placed.values() for _ in range(networks)],
        LOADS_MM,
        LENGTH_MM,
        seed=seed,
        max_epochs=max_epochs,
        progress=progress,
    )
    return {
        layout: _measured(layout, positions, tuple(trained[index * networks : (index + 1) * networks]), seed)
        for index, (layout, positions) in enumerate(placed.items())
    }


def _measured(layout: Layout, positions: Floats, networks: tuple[PaperNetwork, ...], seed: int) -> Performance:
    unit_mm = float(deflection_mm([LENGTH_MM / 2], [LENGTH_MM / 2])[0, 0]) / 100
    influence = influence_of(SCENE)
    clean = limit.draw(Prior.of(influence, positions, 0.0), DRAWS, seed)
    rng = np.random.default_rng([seed, layout.sensors])
    noise = rng.normal(scale=unit_mm, size=clean.deflection_mm.shape)
    errors = np.array(
        [
            [
                np.abs(network.estimate_mm(clean.deflection_mm + percent * noise) - clean.position_mm).mean()
                for percent in NOISES_PERCENT
            ]
            for network in networks
        ]
    )
    noise_mm = RIG_NOISE_PERCENT * unit_mm
    best = limit.accuracy_limit(Prior.of(influence, positions, noise_mm), LIMIT_DRAWS, seed)
    return Performance(layout, positions, networks, errors / LENGTH_MM * 100, best)
