"""The tare file: who may read it, whatever the umask of the user who tares, and what its age is worth to a start."""

import os
import stat
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from support.surfaces import configs

from .devices import pymodbus_server
from .noisy_beam import NoisyBeam
from .process import command, started
from .service import Service, serving

pytestmark = pytest.mark.anyio

CLOSED = "import os; os.umask(0o077)"
"""As some distributions set it for root."""


@pytest.mark.promise("docs/how-to/debian.md", "measures the rest gaps and keeps them in `/etc/beamtouch`")
@pytest.mark.parametrize("before", [None, 0o600])
async def test_the_service_user_reads_what_root_tared(tmp_path: Path, before: int | None) -> None:
    path = tmp_path / "bench.tare.json"
    if before is not None:
        path.write_text("old")
        path.chmod(before)
    async with pymodbus_server([20_500, 21_000]) as port:
        config = configs.write(tmp_path, configs.surface(source=configs.tcp(port)))
        tared = await command("tare", config, code=CLOSED)
    assert tared.code == 0, tared.err
    assert oct(stat.S_IMODE(path.stat().st_mode)) == "0o644"
    assert path.stat().st_uid == os.geteuid()


@pytest.mark.parametrize(
    ("age", "is_followed"),
    [(timedelta(hours=8), True), (timedelta(days=-1), True), (None, True), (timedelta(0), False)],
    ids=["hours ago", "the clock is behind", "not said", "now"],
)
async def test_a_start_takes_a_change_for_drift_if_the_tare_is_old(
    age: timedelta | None, *, is_followed: bool, tmp_path: Path
) -> None:
    surface = configs.surface(source=configs.tcp(502)).replace("rate_hz", "noise_mm = 0.002\nrate_hz", 1)
    surface += "[surfaces.bench.zero_tracking]\ndrift_um_per_min = 5\nmax_mm = 0.05\n"
    async with serving(Service()) as service, pymodbus_server([20_300, 20_300], NoisyBeam(30.0).answer) as port:
        config = configs.write(tmp_path, surface.replace("port = 502", f"port = {port}"), url=service.url)
        configs.tare(tmp_path, taken_at="" if age is None else str(datetime.now(UTC) - age))
        async with started("run", config):
            await service.until(400)
    mean_um = sum(1e3 * (sample.deflection_mm[0] or 0.0) for sample in service.samples()[-100:]) / 100
    assert mean_um == pytest.approx(0.0 if is_followed else 30.0, abs=2.0)
