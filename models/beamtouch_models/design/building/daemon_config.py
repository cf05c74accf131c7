"""The daemon's configuration for a model, ready to run against the rig. The daemon owns and checks the format."""

import secrets
from importlib.resources import files
from pathlib import Path

import numpy as np
from jinja2 import Environment, StrictUndefined

from beamtouch_common.files import write_atomically
from beamtouch_common.units import direction_of
from beamtouch_models.design.building.replaced import sealed
from beamtouch_models.design.physics.characteristic_fit import Characteristic
from beamtouch_models.design.pricing.walk import smallest_mm, walk_of
from beamtouch_models.design.surface import Surface, resolve_model
from beamtouch_models.runtime.metadata import Metadata

TOKEN_FILE = "beamtouch.token"  # noqa: S105  # the name of a file, not a secret
RIG_PORT = 5020
SERVICE_URL = "http://127.0.0.1:8420"


def daemon_config(metadata: Metadata) -> str:
    """Return the TOML text of a configuration with one surface, with the model's name and characteristic.

    What the scene does not state has no line: the noise of a reading (the daemon then estimates it), the drift of a
    rest gap, the slowest period of a beam of unknown mass, and the bits of the ADC (the type of the counts has ends).

    >>> daemon_config(model.metadata).splitlines()[0]
    '# Acquisition of the surface "strip". Check this file with `beamtouch-daemon check`.'
    """
    return config_of(metadata, resolve_model(metadata))


def config_of(metadata: Metadata, surface: Surface) -> str:
    """Return the same for a model whose surface is known."""
    # Names have letters, digits and "_.-" only: nothing is to be escaped.
    form = Environment(undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True).from_string(  # noqa: S701  # TOML
        files(__package__).joinpath("daemon_config.toml.j2").read_text(encoding="utf-8")
    )
    text = form.render(
        dict(metadata),
        service_url=SERVICE_URL,
        token_file=TOKEN_FILE,
        rig_port=RIG_PORT,
        drift_mm=surface.readings.drift_mm,
        period_ms=surface.slowest_period_ms,
        adc_bits=surface.scene.sensors.adc_bits,
        unseen_swing=surface.unseen_swing,
        smallest_mm=smallest_mm(metadata),
        walk=walk_of(metadata, surface.readings),
        tables=[_table_of(metadata, each) for each in surface.characteristics_of(metadata.layout_mm)],
    )
    return sealed(text)


def _table_of(metadata: Metadata, characteristic: Characteristic) -> list[list[float]]:
    """Return the characteristic of a curved sensor from counts to gap, ascending, from that of its deflection.

    The table of the scene was recorded with the straight characteristic of the model's sensor.
    """
    sensor, towards = metadata.sensor, direction_of(metadata.unit)
    shown_mm, straight_mm = (
        sensor.standoff_mm + towards * mm for mm in (characteristic.shown_mm, characteristic.straight_mm)
    )
    counts = (shown_mm - sensor.offset_mm) / sensor.gain_mm_per_count
    points = np.column_stack([counts, straight_mm])
    points = points[points[:, 0].argsort()]
    return [[round(float(count), 2), round(float(gap), 6)] for count, gap in points]


def write_token_if_absent(folder: Path) -> Path:
    """Write a random token that only its owner may read, unless the file exists; returns its path."""
    path = folder / TOKEN_FILE
    if not path.exists():
        write_atomically(path, f"{secrets.token_urlsafe(32)}\n".encode(), mode=0o600)
    return path
