"""The files of one surface whose models go through stages, for tests: contents, and the commands on them."""

from pathlib import Path

from beamtouch_service.host import rollout
from support.programs.in_process import Command
from support.surfaces.small_model import content_of

OLD, NEW, NEWER = content_of("old"), content_of("new"), content_of("newer")
OTHER_BEAM = content_of("new", beam="beam-2")
BAD = {
    "damaged or not an ONNX file": NEW[: len(NEW) // 2],
    "the file is empty": b"",
    "golden answers": NEW.replace(b"130.", b"131."),
    "a service needs more outputs than it has": content_of("new", outputs=("position_mm",)),
    "it is of beam beam-2, the model in use of beam-1": OTHER_BEAM,
    "is the model in use already": OLD,
}
"""What is complained of -> the content of a candidate that is not taken."""


class Files:
    """The files of one surface, and the commands on them."""

    def __init__(self, folder: Path, command: Command) -> None:
        self.folder, self.command = folder, command
        self.config = folder / "service.toml"
        self.config.write_text("[surfaces.press-7]\nmodel = 'press-7.onnx'\n")
        self.model = folder / "press-7.onnx"
        self.candidate, self.previous = rollout.candidate_of(self.model), rollout.previous_of(self.model)
        self.model.write_bytes(OLD)

    def take(self, *options: str, command: str = "take") -> tuple[object, str]:
        """Return exit code and what is said, on both streams."""
        outcome = self.command(command, "--config", self.config, "press-7", *options)
        return outcome.returncode, outcome.stdout + outcome.stderr

    def take_back(self) -> tuple[object, str]:
        return self.take(command="take-back")

    @property
    def contents(self) -> dict[str, bytes]:
        """The files of the folder by the middle of their name, but for the configuration."""
        names = {"press-7.onnx": "model", "press-7.candidate.onnx": "candidate", "press-7.previous.onnx": "previous"}
        return {names.get(one.name, one.name): one.read_bytes() for one in self.folder.glob("*onnx*")}
