"""Reads the body of `POST /surfaces/NAME/samples`: JSON, a batch, covariances.

A large body is read in steps. In one, pydantic takes a tenth of a second for a megabyte of numbers, and seconds to list
what is wrong with one.
"""

from collections.abc import Iterator
from typing import TypeVar

from pydantic import BaseModel, ValidationError
from pydantic_core import from_json, to_json

from beamtouch_service.api.errors import MAX_ERRORS, invalid_request, pointer
from beamtouch_service.problems import Kind, Problem, ProblemError
from beamtouch_service.samples import MAX_SAMPLES, Batch, Sample
from beamtouch_service.steps import Stepper
from beamtouch_service.surfaces.covariances import find_flaws

_AT_ONCE_BYTES = 8192
"""A body up to this size is read in one step, of a millisecond."""
_MAX_UNKNOWN = 20
"""Unknown keys of an object that are looked at."""
_Model = TypeVar("_Model", bound=BaseModel)
_Location = tuple[int | str, ...]
"""Keys and indices that lead to a part of a body."""


async def read_batch(body: bytes, stepper: Stepper) -> Batch:
    """Read a batch; raises ProblemError (400 if it is not JSON, 422 with the locations that are wrong)."""
    reader = _BatchReader()
    await stepper.finish(reader.steps(body))
    if reader.batch is None or reader.flaws:
        flaws = [{"pointer": pointer(location), "detail": words} for location, words in reader.flaws[:MAX_ERRORS]]
        raise ProblemError(invalid_request(flaws, reader.count))
    return reader.batch


class _BatchReader:
    """Reads one body."""

    def __init__(self) -> None:
        self.batch: Batch | None = None
        self.flaws: list[tuple[_Location, str]] = []
        """The first flaws: where each is, and what is wrong there."""
        self.count = 0
        """Number of all flaws."""

    def steps(self, body: bytes) -> Iterator[None]:
        """Read a body; raises ProblemError if it is not JSON."""
        if len(body) <= _AT_ONCE_BYTES:
            self.batch = self._read(Batch, body)
        else:
            yield from self._read_large(body)
        for flaws in find_flaws(self.batch.samples) if self.batch else ():
            for index, reason in flaws.items():
                self._note(("samples", index), f"Value error, covariance_mm2 {reason}")
            yield

    def _read_large(self, body: bytes) -> Iterator[None]:
        try:
            content = from_json(body)
        except ValueError as error:
            raise _malformed(f"Invalid JSON: {error}") from None
        yield
        rows = content.get("samples") if isinstance(content, dict) else None
        if not isinstance(rows, list):
            self._read(Batch, _json(Batch, content if isinstance(content, dict) else 0))
            return
        self._validate(Batch, content | {"samples": []})
        if len(rows) > MAX_SAMPLES:
            words = f"List should have at most {MAX_SAMPLES} items after validation, not {len(rows)}"
            self._note(("samples",), words)
            return
        samples: list[Sample] = []
        for index, row in enumerate(rows):
            if (sample := self._validate(Sample, row, ("samples", index))) is not None:
                samples.append(sample)
            yield
        if not self.count:
            self.batch = self._validate(Batch, content | {"samples": samples})

    def _read(self, model: type[_Model], text: bytes, at: _Location = ()) -> _Model | None:
        """Read JSON as a model; note what is wrong."""
        try:
            return model.model_validate_json(text)
        except ValidationError as error:
            self._note_all(error, at)
            return None

    def _validate(self, model: type[_Model], content: object, at: _Location = ()) -> _Model | None:
        """Return values as a model; note what is wrong, in the words for JSON."""
        try:
            return model.model_validate(content)
        except ValidationError as error:
            count = error.error_count()
            if len(self.flaws) >= MAX_ERRORS:
                self.count += count
            elif count == 1 and error.errors(include_url=False)[0]["type"] == "value_error":  # ours
                self._note_all(error, at)
            else:
                return self._read(model, _json(model, content), at)
            return None

    def _note_all(self, error: ValidationError, at: _Location) -> None:
        # Neither input nor context: a wrong body can be a megabyte long, and an answer is no place to repeat it.
        found = error.errors(include_url=False, include_input=False, include_context=False)
        if found[0]["type"] == "json_invalid":
            raise _malformed(found[0]["msg"])
        for entry in found:
            self._note(at + entry["loc"], entry["msg"])

    def _note(self, location: _Location, words: str) -> None:
        self.count += 1
        if len(self.flaws) < MAX_ERRORS:
            self.flaws.append((location, words))


def _json(model: type[BaseModel], content: object) -> bytes:
    """Return the JSON of a value that may not fit a model, without most of its unknown keys."""
    if isinstance(content, dict):
        many = set([key for key in content if key not in model.model_fields][_MAX_UNKNOWN:])
        content = {key: value for key, value in content.items() if key not in many}
    return to_json(content, inf_nan_mode="constants")


def _malformed(reason: str) -> ProblemError:
    return ProblemError(Problem(Kind.MALFORMED_JSON, f"{reason}; send a batch as application/json."))
