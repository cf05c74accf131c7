"""The files of a build: the model, the daemon's configuration and the report."""

from pathlib import Path

from beamtouch_common.files import write_atomically
from beamtouch_models.design.building.build import Built
from beamtouch_models.design.building.daemon_config import config_of
from beamtouch_models.design.sweeps import Progress, silent


def write_products(
    built: Built,
    *,
    model: Path | None = None,
    config: Path | None = None,
    report: Path | None = None,
    progress: Progress = silent,
) -> None:
    """Write the model, the daemon's configuration and the report of a build, each where a file is given for it."""
    # The report is measured before anything is written: a build that is interrupted leaves no file.
    page_text = ""
    if report is not None:
        # Most builds write none, and its drawings and its template are a tenth of what a build would import.
        from beamtouch_models.design.building.report import facts, page  # noqa: PLC0415

        page_text = page.page(facts.gather(built, progress))
    if model is not None:
        write_atomically(model, built.content)
    if report is not None:
        write_atomically(report, page_text.encode())
    if config is not None:
        write_atomically(config, config_of(built.metadata, built.layout.surface).encode())
