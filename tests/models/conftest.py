"""The commands of the models without processes of their own."""

import pytest

from beamtouch_models import cli
from beamtouch_models.rig import cli as rig_cli
from in_process import Command, command_of


@pytest.fixture
def design_sensors_here(capsys: pytest.CaptureFixture[str]) -> Command:
    """`design-sensors` in this process."""
    return command_of(cli.main, capsys)


@pytest.fixture
def rig_here(capsys: pytest.CaptureFixture[str]) -> Command:
    """`beamtouch-rig` in this process, for input that it refuses."""
    return command_of(rig_cli.main, capsys)
