"""The command `design-sensors`. `arguments` has its arguments, and `commands` the work."""

import sys
from collections.abc import Sequence
from importlib import import_module

from beamtouch_common.commands import DONE, Parser, exit_code
from beamtouch_models.arguments import (
    add_build,
    add_calibrate,
    add_challenge,
    add_evaluate,
    add_explain,
    add_inspect,
    add_place,
    add_reproduce,
    add_trade,
)
from beamtouch_models.errors import WRONG_INPUT_ERRORS
from beamtouch_models.new_arguments import add_new, add_scenes

PROGRAM = "design-sensors"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `design-sensors`; returns the exit code: 0 done, 1 failed, 2 wrong input, 130 interrupted by Ctrl-C."""

    def work() -> int:
        options = _parser().parse_args(arguments)
        # Imported here, so that --help is quick and a missing extra is reported in one line.
        import_module(f"beamtouch_models.commands.{options.command}").run(options)
        return DONE

    return exit_code(PROGRAM, "design", work, WRONG_INPUT_ERRORS)


def _parser() -> Parser:
    parser = Parser(PROGRAM, description="Design a touch-sensing beam: sensor positions and model, offline.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, add_arguments, text in (
        ("build", add_build, "place the sensors, make the estimator and write the model file"),
        ("calibrate", add_calibrate, "fit a model to a real beam, using recorded loads or unlabelled contacts"),
        ("challenge", add_challenge, "put a model through touches, ringing, motion, sensor errors and faults"),
        ("evaluate", add_evaluate, "measure a model and compare it with the accuracy limit"),
        ("explain", add_explain, "print how much each physical effect matters in a scene"),
        ("inspect", add_inspect, "print the metadata of a model file"),
        ("new", add_new, "write a commented scene, from arguments or from the answers to a few questions"),
        ("place", add_place, "choose sensor positions and state how much better any other layout could be"),
        ("reproduce", add_reproduce, "recompute the paper's figures and compare them with the paper"),
        ("scenes", add_scenes, "list the scenes that come with the program, or copy one"),
        ("trade", add_trade, "measure accuracy against speed, number of sensors and filter"),
    ):
        add_arguments(commands.add_parser(name, help=text, description=f"{text[0].upper()}{text[1:]}."))
    return parser


if __name__ == "__main__":
    sys.exit(main())
