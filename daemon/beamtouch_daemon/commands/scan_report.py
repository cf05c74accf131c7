"""The findings of a scan, and how they are printed."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from beamtouch_common.table import aligned
from beamtouch_daemon.sources.requests import exception_words
from beamtouch_daemon.sources.traffic import Traffic
from beamtouch_protocol.messages import Hello

KINDS = {4: "input", 3: "holding"}
"""Registers by the function that reads them; reading them changes no device."""

Source = dict[str, str | float]
"""Keys of a `[source]` table."""


@dataclass(frozen=True)
class FoundUnit:
    """A unit that has answered."""

    source: Source
    """Reads it."""
    functions: Sequence[int]
    """Those that give its register 0."""
    refusals: Sequence[int] = ()
    """Exceptions with which it has refused requests that it answered when they were repeated."""

    @property
    def registers(self) -> str:
        """The registers that it has."""
        kinds = ", ".join(KINDS[function] for function in self.functions) or "none: see its manual"
        refused = "".join(f"; refuses some requests: {exception_words(exception)}" for exception in self.refusals)
        return kinds + refused


@dataclass
class Findings:
    """Everything that has answered, and what came that was no answer."""

    target: str
    units: list[FoundUnit] = field(default_factory=list)
    board: tuple[Source, Hello] | None = None
    texts: dict[str, str] = field(default_factory=dict)
    """Text that a device printed, by the settings of the line."""
    noises: dict[str, str] = field(default_factory=dict)
    """Other bytes that came, likewise."""

    @property
    def has_any(self) -> bool:
        """True if anything has answered."""
        return bool(self.units or self.board)

    def note(self, name: str, traffic: Traffic) -> None:
        """Note what came that is no answer, with the settings of the line as its name."""
        if traffic.text:
            self.texts[name] = traffic.text
        elif traffic.noise:
            self.noises[name] = traffic.noise

    def failure(self, remedy: str) -> str:
        """Return what to say of a device that has sent something, but no answer; empty if nothing came.

        Parameters
        ----------
        remedy : What else to try.
        """
        if self.texts:
            name, text = list(self.texts.items())[-1]
            doubt = "is it the right device, and does it start again and again?"
            return f"nothing answers, but at {name}, the device prints text: {text!r}; {doubt}"
        if self.noises:
            noises = ", ".join(f"{noise} at {name}" for name, noise in self.noises.items())
            return f"nothing answers, but bytes came that are no answer: {noises}; stop other masters, or {remedy}"
        return ""

    def print(self, *, as_json: bool) -> None:
        """Print everything that has answered."""
        if as_json:
            board = None if self.board is None else {"source": self.board[0], **asdict(self.board[1])}
            print(json.dumps({"target": self.target, "units": list(map(_unit_as_json, self.units)), "board": board}))
            return
        if self.board is not None:
            source, hello = self.board
            print(f"a Beamtouch board at {source['baud']} baud: {_describe(hello)}\n\n{_init_command(source)}")
        if self.units:
            head = ("unit", "baud", "parity", "registers from 0")
            print("\n".join(aligned(head, [_row(unit) for unit in self.units])))
            print(f"\n{_init_command(self.units[0].source)}")


def _unit_as_json(unit: FoundUnit) -> dict[str, object]:
    refusals = {"refusals": list(unit.refusals)} if unit.refusals else {}
    return {"source": unit.source, "registers": [KINDS[function] for function in unit.functions], **refusals}


def _row(unit: FoundUnit) -> tuple[str, ...]:
    source = unit.source
    return str(source["unit"]), str(source.get("baud", "-")), str(source.get("parity", "-")), unit.registers


def _init_command(source: Source) -> str:
    """Return the command that writes a configuration with a source."""
    if source["kind"] == "modbus-tcp":
        host = f"[{source['host']}]" if ":" in str(source["host"]) else source["host"]
        where = f"tcp://{host}:{source['port']}"
    else:
        where = f"{'serial' if source['kind'] == 'serial' else 'rtu'}:{source['port']}"
    keys = [key for key in ("baud", "parity", "unit", "function", "timeout_ms") if key in source]
    options = " ".join(f"--{key.replace('_', '-')} {source[key]}" for key in keys)
    return f"beamtouch-daemon init daemon.toml --model-config FILE --source {shlex.quote(where)} {options}"


def _describe(hello: Hello) -> str:
    if not hello.is_compatible:
        return f"it speaks protocol {hello.protocol_version}, another than this daemon; update the older of the two"
    return f"{hello.channel_count} channels, {hello.adc_bits} ADC bits, at most {hello.max_rate_hz} readings per second"
