"""Zeros over a restart: a load that came meanwhile is no drift, while what is known of the zeros is from before it."""

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from support.surfaces import configs

from .devices import pymodbus_server
from .faulty import LOG_FILE
from .noisy_beam import NoisyBeam
from .process import started
from .service import Service, serving

pytestmark = pytest.mark.anyio

ZEROS = "beamtouch-daemon.samples.zeros.json"
HOURS_AGO = str(datetime.now(UTC) - timedelta(hours=8))


async def shown_um(folder: Path, beam: NoisyBeam, publish: str = "") -> tuple[float, str]:
    """Run the daemon for two seconds; return what the samples said in the end [um], and what it logged."""
    surface = configs.surface(source=configs.tcp(502)).replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
    surface += "[surfaces.bench.zero_tracking]\ndrift_um_per_min = 5\nmax_mm = 0.05\n"
    async with serving(Service()) as service, pymodbus_server([20_000, 20_000], beam.answer) as port:
        config = configs.write(folder, surface.replace("port = 502", f"port = {port}"), url=service.url)
        config.write_text(config.read_text().replace("batch_ms", f"{publish}batch_ms"))
        async with started("run", config) as daemon:
            await service.until(400)
            outcome = await daemon.stop()
    mean_um = sum(1e3 * (sample.deflection_mm[0] or 0.0) for sample in service.samples()[-100:]) / 100
    return mean_um, outcome.err


@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md",
    "After a restart of the daemon, they go on from the last rest before it, which is kept beside the log",
)
@pytest.mark.promise("docs/reference/daemon-configuration.md", "The zeros of the last rest are kept beside it.")
async def test_a_load_that_came_while_the_daemon_was_off_is_no_drift(tmp_path: Path) -> None:
    configs.tare(tmp_path, taken_at=HOURS_AGO)
    beam = NoisyBeam(30.0)
    at_rest_um, first = await shown_um(tmp_path, beam)
    file = tmp_path / ZEROS
    content = json.loads(file.read_text())
    absent = content["surfaces"]["absent"] = content["surfaces"]["bench"]  # of a surface that is away from now on
    file.write_text(json.dumps(content))
    beam.um += 15.0
    loaded_um, second = await shown_um(tmp_path, beam)
    again_um, _ = await shown_um(tmp_path, beam)
    beam.um -= 15.0
    lifted_um, _ = await shown_um(tmp_path, beam)
    assert [at_rest_um, loaded_um, again_um, lifted_um] == pytest.approx([0.0, 15.0, 15.0, 0.0], abs=2.0)
    words = "bench: of its zeros, only those of the tare are known"
    assert (words in first, words in second) == (True, False)
    kept = json.loads(file.read_text())["surfaces"]
    assert (kept["absent"], kept["bench"] != absent) == (absent, True)


@pytest.mark.promise("docs/explanation/readings-to-samples.md", "After a restart of the machine")
@pytest.mark.parametrize("case", ["tared again", "the machine started again", "damaged", "not allowed"])
async def test_zeros_that_no_longer_count_are_not_used(case: str, tmp_path: Path) -> None:
    configs.tare(tmp_path, taken_at=HOURS_AGO)
    beam = NoisyBeam(30.0)
    await shown_um(tmp_path, beam)
    file = tmp_path / ZEROS
    content = json.loads(file.read_text())
    assert content["surfaces"]["bench"]["zero_mm"] == pytest.approx([0.03, 0.03], abs=0.002)
    if case == "tared again":
        content["surfaces"]["bench"]["characteristic"] = "of another tare"
    elif case == "the machine started again":
        content["started"] = "before"
    elif case == "not allowed":
        content["surfaces"]["bench"]["deviation_mm"][0] = -1.0
    file.write_text("{" if case == "damaged" else json.dumps(content))
    beam.um = 10.0
    shown, said = await shown_um(tmp_path, beam)
    assert shown == pytest.approx(0.0, abs=2.0)
    assert (f"{file}: damaged; the zeros of before are not known" in said) == (case in {"damaged", "not allowed"})
    assert json.loads(file.read_text())["surfaces"]["bench"]["zero_mm"] == pytest.approx([0.01, 0.01], abs=0.002)


async def test_a_file_that_cannot_be_written_stops_nothing(tmp_path: Path) -> None:
    configs.tare(tmp_path, taken_at=HOURS_AGO)
    (tmp_path / ZEROS).mkdir()
    shown, said = await shown_um(tmp_path, NoisyBeam(30.0))
    assert shown == pytest.approx(0.0, abs=2.0)
    assert f"{tmp_path / ZEROS}: Is a directory; a restart will not know the zeros" in said


@pytest.mark.promise("docs/reference/daemon-configuration.md", "0: neither file.")
@pytest.mark.promise(
    "docs/explanation/readings-to-samples.md", "or with `log_mb = 0`, only the tare is known, and its age"
)
async def test_without_a_log_neither_file_is_kept_and_a_start_knows_the_tare_only(tmp_path: Path) -> None:
    configs.tare(tmp_path, taken_at=HOURS_AGO)
    for um in (30.0, 45.0):
        shown, said = await shown_um(tmp_path, NoisyBeam(um), "log_mb = 0\n")
        assert shown == pytest.approx(0.0, abs=2.0)
        assert "bench: of its zeros, only those of the tare are known" in said
    assert not any((tmp_path / name).exists() for name in (ZEROS, LOG_FILE))
