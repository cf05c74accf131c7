"""What counts, sums up or may be left out starts where nothing has happened yet."""

from collections.abc import Sequence

import numpy as np
import pytest

from beamtouch_daemon.running.daemon import Summary
from beamtouch_daemon.sources.reading import Reading
from beamtouch_daemon.sources.registers import RegisterAnswer
from beamtouch_models.design.calibration.recordings import UnlabelledContacts
from beamtouch_models.filters.chain import Mean
from beamtouch_models.lab.rig.devices import Module
from beamtouch_models.lab.rig.faults import Fault
from beamtouch_models.runtime.decision.decider import Memory, State
from beamtouch_models.runtime.health.residuals import LoadErrors
from beamtouch_protocol.framing import DecoderCounts
from beamtouch_service.api.context import Streams
from beamtouch_service.record.events.health import StoredHealth
from beamtouch_service.surfaces.comparison import Comparison
from beamtouch_service.surfaces.order import SampleCounts


@pytest.mark.parametrize(
    ("made", "names"),
    [
        (Summary(), ("readings", "readings_lost", "samples_published", "samples_dropped", "samples_in_log")),
        (Reading(1.5, ()), ("lost", "failed")),
        (RegisterAnswer((7,)), ("exception", "asked_s")),
        (UnlabelledContacts(np.ones((1, 2)), np.ones((1, 2))), ("other_characteristic", "older")),
        (Module(), ("register",)),
        (Fault("stuck"), ("begin_s",)),
        (Memory(State.CLEAR), ("still", "changing", "run")),
        (LoadErrors(placing_mm=1.5, force=0.5), ("residual_mm",)),
        (DecoderCounts(), ("frames", "rejected")),
        (Streams(), ("open",)),
        (StoredHealth(), ("version", "newest_us")),
        (Comparison(), ("samples", "compared_s")),
        (SampleCounts(), ("accepted", "repeated", "lost")),
    ],
    ids=lambda value: type(value).__name__,
)
def test_what_counts_starts_at_0(made: object, names: Sequence[str]) -> None:
    assert {name: getattr(made, name) for name in names} == dict.fromkeys(names, 0)


def test_a_mean_is_of_one_reading_and_a_module_is_unit_1_unless_stated() -> None:
    mean, module = Mean(), Module()
    assert (mean.window, mean.longest, mean.most) == (1, 1, 1)
    assert (module.unit, module.function) == (1, 4)
    assert Comparison().undecided == (0, 0)
