"""The products of a build: the model, the daemon's configuration and the report."""

import re
from pathlib import Path
from typing import Literal

from numpy.typing import ArrayLike

from beamtouch_common.files import require_writable, write_atomically
from beamtouch_common.names import NAME, RULE
from beamtouch_models.design.building.build import Built, Choices, build_model
from beamtouch_models.design.building.daemon_config import daemon_config as daemon_config_of
from beamtouch_models.design.building.mounted import conflict_of
from beamtouch_models.design.building.replaced import require_replaceable
from beamtouch_models.design.building.sensors import count_of
from beamtouch_models.design.effort import Effort
from beamtouch_models.design.placement.placing import DEFAULT_AIM, Aim
from beamtouch_models.design.scene import Scene, change_scene, format_scene, load_scene, path_of, read_scene
from beamtouch_models.design.sweeps import Progress, silent
from beamtouch_models.errors import SceneError, require
from beamtouch_models.names import ESTIMATORS, Criterion, EstimatorName
from beamtouch_models.numbers import number, places_in, whole


def build(  # noqa: PLR0913  # one for each option of the command
    scene: Path | str | Scene,
    name: str = "surface",
    *,
    sensors: int | None = None,
    sensor_mm: ArrayLike | None = None,
    criterion: Criterion = DEFAULT_AIM.criterion,
    spare: Literal[0, 1] = 0,
    estimator: EstimatorName = ESTIMATORS[0],
    daemon_config: Path | str | None = None,
    report: Path | str | None = None,
    seed: int = 0,
    force: bool = False,
    effort: float = 1.0,
) -> bytes:
    """Build the model of a scene, as `design-sensors build` does.

    Parameters
    ----------
    scene : path of a TOML file, TOML text, or a scene; as that of `read_scene`
    name : name of the surface
    sensors : number of sensors; default: as the scene states
    sensor_mm : (sensors,) positions in mm from the left end, as those of `place`; default: the sensors are placed
    criterion, spare : as those of `place`
    estimator : "posterior", "small-network" or "paper-network"
    daemon_config, report : files to write beside: a configuration for the daemon (TOML), and a report (HTML)
    seed : seed of all random numbers; the same seed gives the same bytes
    force : whether to replace a configuration that was edited after a build wrote it, or another file
    effort : share of the usual work, from 0.01 to 100; less is quicker, with a layout that may not be the best one and
        figures with larger standard errors

    Returns
    -------
    The content of the model file.

    Raises
    ------
    InputError
        It is not a scene, or a file cannot be written, or would be lost.
    SceneError
        The scene cannot be built; the message says why.
    NotGoodEnoughError
        The model misses the accuracy limit.
    """
    path = None if isinstance(scene, Scene) else path_of(scene)
    if isinstance(scene, Scene):
        stated, text = scene, format_scene(scene)
    else:
        stated, text = (read_scene(scene), str(scene)) if path is None else load_scene(path)
    require(name, str, "name", "text")
    if not re.fullmatch(NAME, name):
        raise SceneError(f"name = {name!r} must {RULE}")
    if estimator not in ESTIMATORS:
        raise SceneError(f"estimator = {estimator!r} must be one of {', '.join(ESTIMATORS)}")
    count, kept_mm = count_of(sensors), tuple[float, ...]()
    if sensor_mm is not None:
        kept_mm = tuple(places_in(sensor_mm, "sensor_mm", stated.beam.length_mm).tolist())
        if count not in (None, len(kept_mm)):
            raise SceneError(f"sensors = {count}, but sensor_mm has {len(kept_mm)} positions: give one of the two")
        if conflict := conflict_of(kept_mm, change_scene(stated, sensors={"count": len(kept_mm)})):
            raise SceneError(f"sensor_mm: {conflict}")
    config_file, report_file = (None if one is None else Path(one) for one in (daemon_config, report))
    require_writable((config_file, report_file), () if path is None else (path,))
    if not force:
        require_replaceable(config=config_file, report=report_file, instead="name another one, or give force=True")
    built = build_model(
        stated,
        text,
        name,
        count=count,
        seed=whole(seed, "seed", 0),
        progress=silent,
        choices=Choices(estimator, Aim(criterion, spare, effort=Effort(number(effort, "effort"))), kept_mm),
    )
    write_products(stated, built, config=config_file, report=report_file)
    return built.content


def write_products(
    scene: Scene,
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
        from beamtouch_models.design.building.report.page import gather, page  # noqa: PLC0415

        page_text = page(gather(scene, built, progress))
    if model is not None:
        write_atomically(model, built.content)
    if report is not None:
        write_atomically(report, page_text.encode())
    if config is not None:
        write_atomically(config, daemon_config_of(built.metadata).encode())
