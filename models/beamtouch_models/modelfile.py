"""The one deployable file: an ONNX graph whose metadata says everything that is needed to run it.

The service takes this module and no other of the package, so it imports onnxruntime, numpy and pydantic only.
Writing a model file is in `export`.
"""

import hashlib
import json
import os
import stat
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import onnxruntime as ort
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, ValidationError, model_validator

from beamtouch_models import model_trial
from beamtouch_models.errors import InputError

SCHEMA_VERSION: Literal[1] = 1
METADATA_PREFIX = "beamtouch."
INPUTS = ("deflection_mm", "valid")
POSITION_OUTPUTS = ("position_mm", "position_low_mm", "position_high_mm", "contact_log_odds")
FORCE_OUTPUTS = ("force_n", "force_low_n", "force_high_n")

GOLDEN_TOLERANCE = 1e-3
"""How far a golden answer may come out from what the file states, in mm, N and nats; float32 needs a tenth of it."""

MAX_BYTES = 4 * 1024 * 1024
"""Of a model file: a hundred times the largest that `design-sensors build` makes."""

_NAME = r"^[A-Za-z0-9_.-]{1,64}$"

Answers = dict[str, NDArray[np.float32]]


class ModelFileError(InputError):
    """A file that is not a model, or a model that does not give its own golden answers."""


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Channel(_Strict):
    """One sensor of the layout."""

    name: str = Field(pattern=_NAME)
    position_mm: FiniteFloat
    """From the left end of the beam."""


class Ranges(_Strict):
    """What the model was made for; outside of it, it knows nothing."""

    position_mm: tuple[FiniteFloat, FiniteFloat]
    force_n: tuple[PositiveFloat, PositiveFloat]
    """Equal ends: the force is known."""


class Noise(_Strict):
    """Standard deviations in mm."""

    reading_mm: float = Field(ge=0)
    sample_mm: float = Field(ge=0)
    """After the filter; what the model was trained with."""


class FilterChoice(_Strict):
    """The filter between reading and sample that the model was made for."""

    kind: Literal["none", "moving-average"] = "none"
    window: int = Field(default=1, ge=1)
    spike_mm: PositiveFloat | None = None
    """A reading further than this from the median of the last three is a spike; null: no spike filter."""
    settling_ms: float = Field(default=0.0, ge=0)
    """From the first reading of a new load to the first sample that knows only that load."""


class Sensor(_Strict):
    """What every channel has in common."""

    rate_hz: PositiveFloat
    range_mm: tuple[PositiveFloat, PositiveFloat]
    standoff_mm: PositiveFloat
    """Gap at rest."""
    adc_bits: int = Field(ge=6, le=16)
    gain_mm_per_count: FiniteFloat
    offset_mm: FiniteFloat
    """gap in mm = offset + gain x counts, the nominal characteristic."""


class Accuracy(_Strict):
    """Mean |position error| in percent of the length (eq. 5 of the paper), over the scene's ranges."""

    error_percent: float
    error_standard_error: float
    limit_percent: float
    limit_standard_error: float
    ratio_standard_error: float | None = None
    """Of the ratio, both on the same contacts; None in a file that does not state it."""

    @property
    def ratio(self) -> float:
        """Error over the accuracy limit; 1 is the best that any estimator can do."""
        return self.error_percent / self.limit_percent if self.limit_percent else float("nan")


class Departures(_Strict):
    """How a real surface differs from its scene: what a calibration fits. Lists have an entry per channel."""

    position_offset_mm: list[FiniteFloat]
    """True position of a sensor less that of the layout."""
    gain: list[PositiveFloat]
    """How many times as large a channel states a deflection."""
    offset_mm: list[FiniteFloat]
    """What a channel states at rest."""
    curve_per_mm: FiniteFloat = 0.0
    """y + curve y^2 is in proportion to the deflection, y being what is stated less the offset."""
    fixity: tuple[FiniteFloat, FiniteFloat] = (0.0, 0.0)
    """Of the leftmost and of the rightmost support."""
    rigidity: PositiveFloat = 1.0
    """Factor on E I."""


class Calibration(_Strict):
    """A fit to recorded loads; errors are means over them, in mm."""

    departures: Departures
    fitted: list[str]
    """Which kinds of departures the loads support; the others are as the scene says."""
    loads: int
    unexplained_mm: float = Field(ge=0)
    """What is left of a stated deflection, beyond its noise, when its load is left out of the fit; in the noise."""
    error_before_mm: float
    error_after_mm: float
    """Each load answered by a model that was fitted without it."""


class Golden(_Strict):
    """Inputs with the answers that the graph gave when it was made."""

    deflection_mm: list[list[FiniteFloat]] = Field(min_length=1)
    valid: list[list[bool]] = Field(min_length=1)
    answers: dict[str, list[FiniteFloat]]


class Metadata(_Strict):
    """Everything the file says of itself; each field is one metadata entry, as JSON, under `beamtouch.<field>`."""

    schema_version: Literal[1] = SCHEMA_VERSION
    name: str = Field(pattern=_NAME)
    """Of the scene; the surface's name unless a config gives another."""
    estimator: str
    length_mm: PositiveFloat
    layout: Annotated[list[Channel], Field(min_length=1)]
    """In input order."""
    min_channels: int = Field(ge=1)
    """With fewer working channels than this the model gives no position."""
    ranges: Ranges
    max_deflection_mm: PositiveFloat
    """The largest in the scene, anywhere on the beam, at the largest force."""
    noise: Noise
    filter: FilterChoice
    sensor: Sensor
    contact_threshold: FiniteFloat
    """Contact is stated when `contact_log_odds` exceeds this; without meaning where the graph gives none."""
    seed: int
    accuracy: Accuracy
    calibration: Calibration | None = None
    """None: the model is that of the scene."""
    golden: Golden
    scene: str
    """The scene's TOML text, so that a model can be rebuilt from itself."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        names = [channel.name for channel in self.layout]
        if len(set(names)) != len(names):
            message = "layout: a channel name occurs twice"
            raise ValueError(message)
        if self.min_channels > len(names):
            message = f"min_channels: {self.min_channels} of {len(names)} channels"
            raise ValueError(message)
        rows: list[list[float] | list[bool]] = [*self.golden.deflection_mm, *self.golden.valid]
        if len(self.golden.valid) != len(self.golden.deflection_mm) or any(len(row) != len(names) for row in rows):
            message = f"golden: its inputs are not rows of {len(names)} channels"
            raise ValueError(message)
        return self

    def to_entries(self) -> dict[str, str]:
        """Return the ONNX metadata entries, key to JSON text."""
        fields = self.model_dump(mode="json")
        return {METADATA_PREFIX + key: json.dumps(value, sort_keys=True) for key, value in fields.items()}

    @classmethod
    def from_entries(cls, entries: dict[str, str]) -> "Metadata":
        """Read the ONNX metadata entries; raises ModelFileError naming the first entry that is wrong."""
        ours = {
            key.removeprefix(METADATA_PREFIX): text for key, text in entries.items() if key.startswith(METADATA_PREFIX)
        }
        if not ours:
            message = "it is an ONNX file but not a Beamtouch model: it has no beamtouch metadata"
            raise ModelFileError(message)
        try:
            return cls.model_validate({key: json.loads(text) for key, text in ours.items()})
        except ValidationError as error:
            first = error.errors()[0]
            where = ".".join(str(part) for part in first["loc"])
            reason = first["msg"].removeprefix("Value error, ")
            message = f"metadata entry {METADATA_PREFIX}{where}: {reason}" if where else f"metadata: {reason}"
            raise ModelFileError(message) from None
        except (ValueError, RecursionError):
            # Also numbers and nesting beyond what the parser takes.
            message = "its metadata is not JSON"
            raise ModelFileError(message) from None


@dataclass(frozen=True)
class ModelFile:
    """A loaded model, ready to answer."""

    metadata: Metadata
    identity: str
    """`name@` and the first six hex digits of the file's SHA-256."""
    outputs: tuple[str, ...]
    session: Any
    """The onnxruntime session; onnxruntime ships no types."""

    @property
    def channels(self) -> list[str]:
        """Channel names in input order."""
        return [channel.name for channel in self.metadata.layout]

    def estimate(self, deflection_mm: NDArray[np.float32], valid: NDArray[np.bool_]) -> Answers:
        """Answer a batch.

        Parameters
        ----------
        deflection_mm : (batch, channels) float32, mm, in the order of the layout; what invalid channels hold is ignored
        valid : (batch, channels) bool

        Returns
        -------
        One float32 array (batch,) per output name.
        """
        values = self.session.run(None, {"deflection_mm": deflection_mm, "valid": valid})
        return dict(zip(self.outputs, values, strict=True))


def load(path: Path) -> ModelFile:
    """Load a model file and reproduce its golden answers.

    Raises
    ------
    ModelFileError
        The file cannot be read, is too large, is damaged, is no Beamtouch model, needs too much memory or time, or
        gives other answers than it states.
    """
    return load_bytes(read(path), str(path))


def read(path: Path) -> bytes:
    """Read a model file of at most `MAX_BYTES`; one that is larger, or no regular file, is refused unread.

    Raises
    ------
    ModelFileError
        It cannot be read, is something else, or is too large.
    """
    try:
        # Before it is opened: opening alone does something to a device, and waits at a pipe.
        _require_readable(path.stat(), path)
        with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:  # noqa: PTH123  # by number
            _require_readable(os.fstat(file.fileno()), path)
            content = file.read(MAX_BYTES + 1)
    except OSError as error:
        message = f"{path}: {error.strerror}"
        raise ModelFileError(message) from None
    _require_size(len(content), str(path))
    return content


def _require_readable(status: os.stat_result, path: Path) -> None:
    if not stat.S_ISREG(status.st_mode):
        message = f"{path}: it is no file but something else; put the model file there"
        raise ModelFileError(message)
    _require_size(status.st_size, str(path))


def _require_size(size_bytes: int, origin: str) -> None:
    if size_bytes > MAX_BYTES:
        message = f"{origin}: it is larger than {MAX_BYTES >> 20} MiB, so it is no model of `design-sensors build`"
        raise ModelFileError(message)


def load_bytes(content: bytes, origin: str) -> ModelFile:
    """Load a model from memory; `origin` is named in errors. Raises ModelFileError as `load` does."""
    _require_size(len(content), origin)
    if model_trial.has_functions(content):
        message = f"{origin}: its graph defines functions, so it is no model of `design-sensors build`"
        raise ModelFileError(message)
    try:
        trial = _open(lambda: model_trial.make_session(content, session_options()))
        metadata = Metadata.from_entries(trial.get_modelmeta().custom_metadata_map)
        model = ModelFile(
            metadata=metadata,
            identity=f"{metadata.name}@{hashlib.sha256(content).hexdigest()[:6]}",
            outputs=tuple(output.name for output in trial.get_outputs()),
            session=trial,
        )
        _check_signature(model)
        _check_golden(model)
        session = _open(lambda: model_trial.open_session(content, session_options()))
    except ModelFileError as error:
        message = f"{origin}: {error}"
        raise ModelFileError(message) from None
    return replace(model, session=session)


def _open(make: Callable[[], Any]) -> Any:  # noqa: ANN401  # onnxruntime ships no types
    try:
        return make()
    except Exception as error:  # noqa: BLE001  # onnxruntime's errors have no common base but Exception
        first_line = str(error).splitlines()[0] if str(error) else type(error).__name__
        if "xternal" in first_line and " data" in first_line:
            message = "its weights are in another file; a model is one file: build it again with `design-sensors build`"
        else:
            message = f"damaged or not an ONNX file; build it again with `design-sensors build` ({first_line})"
        raise ModelFileError(message) from None


def session_options() -> ort.SessionOptions:
    """Return options for one thread that does not spin: an answer takes microseconds, and waiting must cost nothing."""
    options = ort.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4
    # No folder: weights in other files are refused, wherever they are said to be.
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", os.devnull)
    return options


def _check_signature(model: ModelFile) -> None:
    inputs = tuple(entry.name for entry in model.session.get_inputs())
    if inputs != INPUTS:
        message = f"its inputs are {', '.join(inputs)} where {', '.join(INPUTS)} are expected"
        raise ModelFileError(message)
    if "position_mm" not in model.outputs:
        message = "it has no output position_mm"
        raise ModelFileError(message)


def _check_golden(model: ModelFile) -> None:
    golden = model.metadata.golden
    with model_trial.limited() as options:
        rows = [_one_row(model, options, *row) for row in zip(golden.deflection_mm, golden.valid, strict=True)]
    for name in model.outputs:
        found = np.array([row[name] for row in rows], np.float32)
        expected = np.array(golden.answers.get(name, []), np.float32)
        if expected.shape != found.shape or not np.allclose(
            found, expected, rtol=GOLDEN_TOLERANCE, atol=GOLDEN_TOLERANCE
        ):
            message = f"its golden answers for {name} do not come out on this machine"
            raise ModelFileError(message)


def _one_row(
    model: ModelFile, options: ort.RunOptions, deflection_mm: list[float], valid: list[bool]
) -> dict[str, float]:
    """Answer one sample as a service does; a graph that cannot is refused."""
    inputs = {"deflection_mm": np.array([deflection_mm], np.float32), "valid": np.array([valid], np.bool_)}
    try:
        values = model.session.run(None, inputs, options)
        return {name: float(value.reshape(())) for name, value in zip(model.outputs, values, strict=True)}
    except Exception as error:  # noqa: BLE001  # onnxruntime's errors have no common base but Exception
        if options.terminate:
            message = f"its golden answers take longer than {model_trial.LIMIT_S:g} s"
            raise ModelFileError(message) from None
        message = f"its graph cannot be run on one sample ({(str(error).splitlines() or [''])[0]})"
        raise ModelFileError(message) from None
