"""Writes docs/page.png: the page of a service that a rig and a daemon have fed for a minute.

`make demo` builds the model first; then `.venv/bin/python tests/docs/page_picture.py`.
"""

import sys
import tempfile
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))
sys.path.append(str(Path(__file__).parents[2] / "demo"))

from line import Line, Surface
from support.pages.browser import chromium, pages

ROOT = Path(__file__).parents[2]
PICTURE = ROOT / "docs" / "page.png"
BUILT = ROOT / "build" / "demo"
SIZE = (1000, 900)
RATE_HZ = 100
"""A rate that a busy machine keeps, too; otherwise the page would say that it does not."""
HISTORY_MS = 62_000
"""The charts show the last minute."""


def main() -> None:
    """Write the picture in a moment of contact."""
    scene, model = ROOT / "models" / "scenes" / "bench.toml", BUILT / "bench.onnx"
    with tempfile.TemporaryDirectory() as folder:
        daemon_config = Path(folder) / "slow.toml"
        daemon_config.write_text((BUILT / "daemon.toml").read_text().replace("rate_hz = 200", f"rate_hz = {RATE_HZ}"))
        with Line(Path(folder), scene, model, daemon_config, [Surface("press-7", "modbus-tcp")]) as line:
            _write(line.url)


def _write(url: str) -> None:
    with (
        chromium() as browser,
        pages(browser) as open_page,
    ):
        seen = open_page(url, size=SIZE, color_scheme="light")
        seen.page.wait_for_timeout(HISTORY_MS)
        calm = "() => document.body.dataset.state === 'contact' && !detail.innerText"
        is_calm = False
        while not is_calm:
            seen.page.wait_for_function(calm)
            picture = seen.page.screenshot(full_page=True)
            is_calm = seen.page.evaluate(calm)
        PICTURE.write_bytes(picture)


if __name__ == "__main__":
    main()
