"""The command `design-sensors`: its commands are modules of `commands`, whose `arguments` has their arguments."""

import sys
from collections.abc import Sequence
from importlib import import_module

from beamtouch_common.commands import DONE, Parser, exit_code
from beamtouch_models.errors import WRONG_INPUT_ERRORS

PROGRAM = "design-sensors"
COMMANDS = {
    "build": "place the sensors, make the estimator and write the model file",
    "calibrate": "fit a model to a real beam, using recorded loads or unlabelled contacts",
    "challenge": "put a model through touches, ringing, motion, sensor errors and faults",
    "evaluate": "measure a model and compare it with the accuracy limit",
    "explain": "print how much each physical effect matters in a scene",
    "inspect": "print the metadata of a model file",
    "new": "write a commented scene of a beam",
    "place": "choose sensor positions and state the accuracy limit of the layout",
    "reproduce": "recompute the paper's figures and compare them with the paper",
    "scenes": "list the scenes that come with the program, or copy one",
    "schema": "print the JSON Schema of a scene, with which editors complete and check its keys",
    "trade": "measure what sensors, time, noise and estimators are worth in accuracy",
}


def main(given: Sequence[str] | None = None) -> int:
    """Run `design-sensors`; returns the exit code: 0 done, 1 failed, 2 wrong input, 130 interrupted by Ctrl-C."""

    def work() -> int:
        words = sys.argv[1:] if given is None else given
        options = _parser(words).parse_args(words)
        # Imported here, so that --help is quick and a missing extra is reported in one line.
        import_module("beamtouch_models.design.sweeps").load_with_one_thread()
        printing = import_module("beamtouch_models.design.printing")
        command = import_module(f"beamtouch_models.commands.{options.command}")
        printing.show(command.run(options), as_json=getattr(options, "json", False))
        return DONE

    return exit_code(PROGRAM, "design", work, WRONG_INPUT_ERRORS)


def _parser(given: Sequence[str]) -> Parser:
    """Return the parser of a command line; only the command that it names has arguments."""
    parser = Parser(PROGRAM, description="Design a touch-sensing beam: sensor positions and model, offline.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, text in COMMANDS.items():
        command = commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}.")
        if name in given:  # the list of commands does not wait for this import
            getattr(import_module("beamtouch_models.commands.arguments"), name)(command)
    return parser


if __name__ == "__main__":
    sys.exit(main())
