"""Settings of the test run, and fixtures of several folders: models and simulated boards, built once per run."""

import gc
import os
import signal
from collections.abc import Callable, Generator, Iterator
from functools import partial
from pathlib import Path
from zlib import crc32

# Before numpy is imported, and for all processes that tests start: threads of two libraries in each of several test
# processes wait for each other, spinning, on the same few cores.
os.environ |= dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import pytest
from hypothesis import HealthCheck, settings
from playwright.sync_api import Browser
from xdist.remote import Producer

import beamtouch_models
from beamtouch_models import runtime
from service.postgres import Postgres, running
from service.process.pgbouncer import pooled
from support.pages.browser import OpenPage, chromium, pages
from support.programs.simulated_board import Board, Boards, build_board, build_firmware
from support.programs.toolchain import made_once
from support.running.scheduling import Scheduling
from support.surfaces.example_scenes import ROUGH, SCENES
from support.surfaces.plate_models import write_plate_model

# A shell may start background work with Ctrl-C ignored. Processes that tests interrupt would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples in each run, and none too slow for a starved machine.
settings.register_profile("the same", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("the same")


class NamesFailures:
    """Names each failure when it happens; the report at the end has the rest."""

    def __init__(self, terminal: pytest.TerminalReporter) -> None:
        self._terminal = terminal

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Write a line for a test that failed."""
        if report.failed:
            self._terminal.write(f"\nFAILED {report.nodeid} ({report.when})\n", red=True)


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Let failures be named, in the one process that has a terminal."""
    terminal = config.pluginmanager.getplugin("terminalreporter")
    if terminal is not None:
        config.pluginmanager.register(NamesFailures(terminal))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Search for no garbage meanwhile: what is imported and collected stays, and the search takes a quarter of it."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put first what takes long, so that no process is left with it at the end while the others have nothing to do.

    The rest are mixed, always in the same way: tests of some folders only wait, and those of others only compute.
    """
    items.sort(key=lambda item: (item.get_closest_marker("long") is None, crc32(item.nodeid.encode())))


def pytest_collection_finish() -> None:
    """Leave out of each search for garbage what stays: thousands of tests, and all modules."""
    gc.freeze()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> Scheduling:
    """Return how tests are given to several processes."""
    return Scheduling(config, log)


@pytest.fixture(scope="session")
def anyio_backend() -> str:
    """Tests that are coroutines run on asyncio."""
    return "asyncio"


ROUGHLY = {"cantilever", "conveyor", "two-spans"}
"""Scenes whose models are asked for the physics and the noise alone, not for thresholds and accuracy."""


def _build(path: Path, name: str, folder: Path, effort: float = 1.0) -> None:
    """Write the model of a scene, `NAME.onnx`, and the configuration for the daemon, `NAME.toml`, into a folder.

    The model has the paper's layout: known numbers that take less time to find.
    """
    surface = beamtouch_models.resolve(beamtouch_models.read_scene(path))
    model = surface.place(criterion="eigenvalue-product", effort=effort).build(name)
    model.save(folder / f"{name}.onnx")
    (folder / f"{name}.toml").write_text(beamtouch_models.daemon_config(model.metadata))


@pytest.fixture(scope="session")
def built_model(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A function from the name of a shipped scene to its model file, beside which is the configuration for the daemon.

    Each is built once, whichever test process asks first.
    """

    def model(name: str) -> Path:
        made = partial(_build, SCENES / f"{name}.toml", name, effort=ROUGH if name in ROUGHLY else 1.0)
        return made_once(tmp_path_factory, f"model-{name}", made) / f"{name}.onnx"

    return model


def _build_for_firmware(folder: Path) -> None:
    """Write the bench scene with the ADC of the firmware's chip, and its model."""
    text = (SCENES / "bench.toml").read_text().replace("rate_hz = 200", "rate_hz = 200\nadc_bits = 10")
    (folder / "scene.toml").write_text(text)
    _build(folder / "scene.toml", "bench", folder, ROUGH)


@pytest.fixture(scope="session")
def ten_bits(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """The bench scene with a 10-bit ADC as in the firmware's chip, and its model; built once per run."""
    folder = made_once(tmp_path_factory, "ten-bits", _build_for_firmware)
    return folder / "scene.toml", folder / "bench.onnx"


@pytest.fixture(scope="session")
def bench_model(built_model: Callable[[str], Path]) -> Path:
    """The model file of `models/scenes/bench.toml`."""
    return built_model("bench")


@pytest.fixture(scope="session")
def bench(bench_model: Path) -> runtime.ModelFile:
    """The same model, loaded."""
    return runtime.load(bench_model)


@pytest.fixture(scope="session")
def plate_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model file of `models/scenes/plate-on-springs.toml`, with its sensors in the corners."""
    return made_once(tmp_path_factory, "plate-model", write_plate_model) / "plate.onnx"


@pytest.fixture(scope="session")
def board_for(tmp_path_factory: pytest.TempPathFactory) -> Boards:
    """A function from a number of channels to a board with a firmware for it; each is built once."""

    def board(channels: int, more: str = "") -> Board:
        program = made_once(tmp_path_factory, "board", build_board) / "board"
        name = f"firmware-{channels}{more}"
        folder = made_once(tmp_path_factory, name, lambda folder: build_firmware(folder, channels, more))
        return Board(program, folder / "firmware.elf")

    return board


@pytest.fixture(scope="session")
def board(board_for: Boards) -> Board:
    """A board with four channels."""
    return board_for(4)


@pytest.fixture(scope="session")
def postgres() -> Iterator[Postgres]:
    """A PostgreSQL server of this test process. A test that stops it starts it again."""
    with running() as server:
        yield server


@pytest.fixture
def events_url(postgres: Postgres) -> str:
    """The URL of a database without tables."""
    return postgres.create()


@pytest.fixture(scope="session")
def pooled_port(postgres: Postgres) -> Iterator[int]:
    """The port of a PgBouncer that pools transactions."""
    with pooled(postgres, "transaction") as port:
        yield port


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with chromium() as started:
        yield started


@pytest.fixture
def open_page(browser: Browser) -> Iterator[OpenPage]:
    with pages(browser) as opened:
        yield opened
