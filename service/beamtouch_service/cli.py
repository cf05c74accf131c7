"""The command `beamtouch-service`."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from beamtouch_common import archive_commands as archives
from beamtouch_common import log_lines
from beamtouch_common.commands import DONE, INTERRUPTED, Parser, exit_code

PROGRAM = "beamtouch-service"
LOGGED = ("api", "record", "host", "outputs", "surfaces")
"""Parts that write log lines: folders."""


def _parser(given: Sequence[str]) -> Parser:
    """Return the parser of a command line."""
    words = "Accept samples over HTTP and state where and how hard something touches the surface."
    parser = Parser(PROGRAM, description=words)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    run = commands.add_parser("run", help="serve until SIGTERM or Ctrl-C")
    if "run" in given:
        _add_run(run)
    words = "Describe a model file or a configuration, or say why the service would refuse it."
    check = commands.add_parser("check", help="describe a model file or a configuration", description=words)
    subject = check.add_mutually_exclusive_group(required=True)
    subject.add_argument("model", nargs="?", metavar="MODEL", help="model file from `design-sensors build`")
    subject.add_argument("--config", metavar="FILE", help="configuration of the service, with the files that it names")
    check.add_argument("--json", action="store_true", help="print one JSON object on standard output")
    _add_models(commands.add_parser("models", help="list the models of all surfaces, with candidates and digests"))
    _add_take(commands.add_parser("take", help="put the candidate of a surface in the place of its model"))
    _add_take_back(commands.add_parser("take-back", help="put the model before the last `take` back in its place"))
    _add_backup(commands.add_parser("backup", help="write all that makes a service into one archive, while it runs"))
    archives.add_restore(commands.add_parser("restore", help="restore an archive of `backup`"))
    _add_registers(commands.add_parser("registers", help="print the Modbus register map"))
    return parser


def _add_models(models: argparse.ArgumentParser) -> None:
    models.description = (
        "List the model file of each surface with its digest, and beside it the candidate, which `take` puts in its "
        "place, and the previous model, which `take-back` puts back."
    )
    models.add_argument("--config", metavar="FILE", required=True, help="configuration of the service")
    models.add_argument("--json", action="store_true", help="print one JSON object on standard output")


def _add_take(take: argparse.ArgumentParser) -> None:
    take.description = (
        "Check the candidate of a surface, and put it in the place of its model, which is kept as the previous one. A "
        "running service uses it within a few seconds."
    )
    _add_surface(take)
    words = "refuse any other candidate: digest (SHA-256) as sha256sum prints it, or its first digits, at least 6"
    take.add_argument("--digest", metavar="HEX", help=words)


def _add_take_back(take_back: argparse.ArgumentParser) -> None:
    take_back.description = (
        "Put the model that was there before the last `take` back in its place. The one that was taken becomes the "
        "candidate again, unless there is a newer one."
    )
    _add_surface(take_back)


def _add_surface(command: argparse.ArgumentParser) -> None:
    command.add_argument("--config", metavar="FILE", required=True, help="configuration of the service")
    command.add_argument("surface", metavar="SURFACE", help="name of the surface in the configuration")


def _add_backup(backup: argparse.ArgumentParser) -> None:
    backup.description = (
        "Write all that makes a service into one archive, while it runs: its configuration, the files that this names, "
        "and its record, with the trail of changes."
    )
    backup.add_argument("--config", metavar="FILE", required=True, help="configuration of the service")
    archives.add_backup(backup)


def _add_registers(registers: argparse.ArgumentParser) -> None:
    registers.description = "Print the map of the Modbus registers that [modbus_server] serves."
    words = "also print the blocks of the surfaces in this configuration of the service, and its word order"
    registers.add_argument("--config", metavar="FILE", help=words)
    words = "also print the block of a surface with this model file; without --config, it is named after the model"
    registers.add_argument("--model", metavar="MODEL", help=words)
    registers.add_argument("--json", action="store_true", help="print one JSON object on standard output")


def _add_run(run: argparse.ArgumentParser) -> None:
    from beamtouch_service.outputs import OUTPUTS

    run.description = "Serve until SIGTERM or Ctrl-C. Options override the configuration file."
    run.add_argument(
        "--model", metavar="MODEL", help="model file; without --config, the surface is named after the model"
    )
    outputs = ", ".join(f"[{output.name}]" for output in OUTPUTS)
    words = f"TOML file with [server], [events], [surfaces.NAME] and outputs: {outputs}"
    run.add_argument("--config", metavar="FILE", help=words)
    words = "address to listen on; addresses beyond loopback require a write and a read token (default: 127.0.0.1)"
    run.add_argument("--host", help=words)
    run.add_argument("--port", type=int, help="port to listen on; 0 picks a free port (default: 8420)")
    words = "file with the token required for writes (default: writes are disabled)"
    run.add_argument("--write-token-file", metavar="FILE", help=words)
    words = "file with the token required for reads (default: reads need no token)"
    run.add_argument("--read-token-file", metavar="FILE", help=words)
    words = "file with the token required for administration (default: the write token administrates)"
    run.add_argument("--admin-token-file", metavar="FILE", help=words)
    run.add_argument("--certificate-file", metavar="FILE", help="PEM certificate for HTTPS; requires --key-file")
    run.add_argument("--key-file", metavar="FILE", help="PEM private key of the certificate")
    words = "limit on the age of a sample that a contact may come from, in ms (default: 500)"
    run.add_argument("--stale-ms", type=float, metavar="N", help=words)
    log_lines.add_level_option(run, "beamtouch_service", LOGGED)


def _check(arguments: argparse.Namespace) -> int:
    from beamtouch_service.config import load_settings

    settings = load_settings(Path(arguments.config), {}) if arguments.config else None
    from beamtouch_service.host import models, setup

    if settings is not None:
        print(setup.report(settings, as_json=arguments.json))
    else:
        print(models.report(Path(arguments.model), as_json=arguments.json))
    return DONE


def _models(arguments: argparse.Namespace) -> int:
    from beamtouch_service.config import load_settings

    settings = load_settings(Path(arguments.config), {})
    from beamtouch_service.host import rollout

    print(rollout.report(settings, as_json=arguments.json))
    return DONE


def _take(arguments: argparse.Namespace) -> int:
    from beamtouch_service.config import load_settings

    settings = load_settings(Path(arguments.config), {})
    from beamtouch_service.host import rollout

    print(rollout.take(settings, arguments.surface, arguments.digest))
    return DONE


def _take_back(arguments: argparse.Namespace) -> int:
    from beamtouch_service.config import load_settings

    settings = load_settings(Path(arguments.config), {})
    from beamtouch_service.host import rollout

    print(rollout.take_back(settings, arguments.surface))
    return DONE


def _back_up(arguments: argparse.Namespace) -> int:
    from beamtouch_service.config import load_settings

    config = Path(arguments.config)
    settings = load_settings(config, {})
    from beamtouch_service.host import backup

    secrets = arguments.with_secrets
    with archives.end_in_order():
        lines = backup.back_up(config, settings, arguments.output, program=PROGRAM, with_secrets=secrets)
    print(*lines, sep="\n")
    return DONE


def _restore(arguments: argparse.Namespace) -> int:
    from beamtouch_common.archives import restore_archive

    with archives.end_in_order():
        restored = restore_archive(arguments.archive, arguments.folder, arguments.root)
    print(*restored, sep="\n")
    return DONE


def _registers(arguments: argparse.Namespace) -> int:
    from beamtouch_service.config import load_settings
    from beamtouch_service.host import models
    from beamtouch_service.outputs.modbus import document
    from beamtouch_service.outputs.modbus.section import ModbusServerSection

    settings = load_settings(Path(arguments.config) if arguments.config else None, {"model": arguments.model})
    named = [models.name_axes(name, section.model) for name, section in settings.surfaces.items()]
    blocks = {
        name: document.Block(section, axes)
        for (name, axes), section in zip(named, settings.surfaces.values(), strict=True)
    }
    sections = [section for section in settings.outputs if isinstance(section, ModbusServerSection)]
    section = sections[0] if sections else ModbusServerSection()
    show = document.as_json if arguments.json else document.as_text
    print(show(blocks, section.word_order))
    return DONE


def _run(arguments: argparse.Namespace) -> int:
    from beamtouch_common.files import digest_of
    from beamtouch_service.config import load_settings

    options = {name: value for name, value in vars(arguments).items() if name not in {"command", "config", "log_level"}}
    config = Path(arguments.config) if arguments.config else None
    settings = load_settings(config, options)
    given = {name: value for name, value in options.items() if value is not None}
    origin = {"config_sha256": digest_of(config) if config else None, "options": given}
    # Imported late: without the extra, a wrong config or the missing extra is still reported in one line.
    from beamtouch_service.host import setup

    try:
        setup.run(settings, origin, arguments.log_level)
    except KeyboardInterrupt:  # the service ended in order; there is nothing to say
        return INTERRUPTED
    return DONE


_WORK = {
    "run": _run,
    "check": _check,
    "models": _models,
    "take": _take,
    "take-back": _take_back,
    "backup": _back_up,
    "restore": _restore,
    "registers": _registers,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command. Returns 0 done, 2 wrong input with one line on standard error, 130 after Ctrl-C."""

    def work() -> int:
        given = sys.argv[1:] if argv is None else argv
        arguments = _parser(given).parse_args(given)
        return _WORK[arguments.command](arguments)

    return exit_code(PROGRAM, "service", work)


if __name__ == "__main__":
    sys.exit(main())
