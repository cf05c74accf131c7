"""The tare file: who may read it, whatever the umask of the user who tares."""

import os
import stat
from pathlib import Path

import pytest

from . import configs
from .devices import pymodbus_server
from .process import command

pytestmark = pytest.mark.anyio

CLOSED = "import os; os.umask(0o077)"
"""As some distributions set it for root."""


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
