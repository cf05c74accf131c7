"""What tests of the models share: commands without processes of their own, and a simulated surface."""

import pytest

from beamtouch_models import cli
from beamtouch_models.accuracy import evaluation
from beamtouch_models.challenge.surface import SimulatedSurface
from beamtouch_models.modelfile import ModelFile
from beamtouch_models.rig import cli as rig_cli
from beamtouch_models.trade import points, timing
from in_process import Command, command_of


@pytest.fixture(scope="session")
def surface(bench: ModelFile) -> SimulatedSurface:
    """The surface of the bench, as `challenge` simulates it."""
    return SimulatedSurface.of(bench.metadata)


@pytest.fixture
def design_sensors_here(capsys: pytest.CaptureFixture[str]) -> Command:
    """`design-sensors` in this process, without workers: what a test shortens here, it does not shorten in them."""

    def main(arguments: list[str]) -> int:
        sweeps = bool(arguments) and arguments[0] in {"trade", "evaluate", "place", "challenge"}
        return cli.main([*arguments, "--workers", "1"] if sweeps else arguments)

    return command_of(main, capsys)


@pytest.fixture
def rig_here(capsys: pytest.CaptureFixture[str]) -> Command:
    """`beamtouch-rig` in this process, for input that it refuses."""
    return command_of(rig_cli.main, capsys)


@pytest.fixture
def short_timing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few inferences are timed, for tests that do not ask how long one takes."""
    monkeypatch.setattr(timing, "CALLS", 5)
    for rounds in ("ROUNDS", "FIRST_ROUNDS"):
        monkeypatch.setattr(points, rounds, 2)


@pytest.fixture
def few_at_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few samples at rest are drawn, for tests that do not ask how many exceed the threshold of contact."""
    monkeypatch.setattr(evaluation, "REST_DRAWS", 2**12)
