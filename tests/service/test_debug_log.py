"""The debug log shows each batch and each decision that changed a state, with its figures; otherwise nothing."""

import logging
import pkgutil
from collections.abc import Iterator
from importlib import import_module

import pytest

import beamtouch_service
from beamtouch_service import cli
from service.bench import TOKEN, Bench, batch_of

REST, TOUCH = (0.0, 0.0, 0.0), (0.5, 0.25, 0.125)


def lines_of(caplog: pytest.LogCaptureFixture, part: str) -> list[str]:
    """Return the debug lines of a part of the service."""
    name = f"beamtouch_service.{part}"
    return [
        record.getMessage()
        for record in caplog.records
        if record.name.startswith(name) and record.levelno == logging.DEBUG
    ]


def test_a_batch_is_logged_with_its_sender_its_samples_and_its_receipt(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("DEBUG", "beamtouch_service.api")
    bench.send(REST, TOUCH, sequence=11)
    (line,) = lines_of(caplog, "api")
    assert line.startswith("press-7: a batch from testclient:")
    assert "boot boot-0001, samples 11 to 12: accepted=2 repeated=0 " in line
    assert "expected=13 " in line


def test_a_batch_without_samples_and_one_that_is_refused_are_logged(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("DEBUG", "beamtouch_service.api")
    assert bench.post(batch_of() | {"samples": []}).status_code == 200
    assert bench.post(batch_of(channels=["a", "b", "c"])).status_code == 422
    empty, refused = lines_of(caplog, "api")
    assert ", no samples: accepted=0 " in empty
    assert "press-7: a batch from testclient:" in refused
    assert " is refused: missing-channels: " in refused


def test_each_change_of_state_is_logged_with_its_figures(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG", "beamtouch_service.surfaces")
    bench.send(REST, REST, TOUCH, TOUCH)
    clear, contact = lines_of(caplog, "surfaces")
    assert clear.startswith("press-7: sample 1: clear: log odds ")
    assert contact.startswith("press-7: sample 3: contact: log odds ")
    for words in (", of a touch ", "; misfit of one contact ", ", of rest ", " of at most "):
        assert words in contact


def test_a_sample_that_is_not_decided_is_logged_with_the_reason_once(
    bench: Bench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("DEBUG", "beamtouch_service.surfaces")
    bench.send((None, None, None), (None, None, None), quality=["missing"] * 3)
    (line,) = lines_of(caplog, "surfaces")
    assert line.startswith("press-7: sample 1: undecided: ")


def test_nothing_of_it_is_logged_unless_it_is_asked_for(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO")
    bench.send(REST, TOUCH)
    assert not [record for record in caplog.records if record.levelno == logging.DEBUG]


def modules_in(folder: str) -> Iterator[str]:
    """Yield the names of all modules of a folder of the service, with those of its folders."""
    package = import_module(f"beamtouch_service.{folder}")
    for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
        yield module.name


def test_levels_can_be_set_for_the_parts_that_write_lines() -> None:
    folders = [folder.name for folder in pkgutil.iter_modules(beamtouch_service.__path__) if folder.ispkg]
    writing = {folder for folder in folders if any(hasattr(import_module(name), "_log") for name in modules_in(folder))}
    assert writing == set(cli.LOGGED)


def test_a_token_is_in_no_line(bench: Bench, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("DEBUG")
    bench.send(REST, TOUCH)
    assert caplog.records
    assert all(TOKEN not in record.getMessage() for record in caplog.records)
