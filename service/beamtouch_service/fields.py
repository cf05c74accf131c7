"""Types of the keys in the configuration, shared by the sections of the service and of its outputs."""

from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationInfo

from beamtouch_common.files import file_path
from beamtouch_common.hosts import host_name


class Section(BaseModel):
    """A table of the configuration. Unknown keys are refused."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, use_attribute_docstrings=True)


def _from_folder(path: Path, info: ValidationInfo) -> Path:
    """Return a path from the folder of the configuration, which the validation context has."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / file_path(path)


Port = Annotated[int, Field(ge=0, le=65535)]
Text = Annotated[str, Field(min_length=1)]
Host = Annotated[Text, AfterValidator(host_name)]
File = Annotated[Path, Field(strict=False), AfterValidator(_from_folder)]


def require_pair(certificate: Path | None, key: Path | None, purpose: str) -> None:
    """Raise ValueError unless there are both files of a certificate, or none."""
    if (certificate is None) != (key is None):
        missing = "certificate_file" if certificate is None else "key_file"
        message = f"{missing} is missing; {purpose} needs a certificate and its key"
        raise ValueError(message)
