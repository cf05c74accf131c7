"""Other ways to the contacts than HTTP, one folder each. A new output is a folder, and a line in `OUTPUTS`."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from beamtouch_common.errors import InputError
from beamtouch_service.outputs.modbus.section import ModbusServerSection
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.opcua.section import OpcUaSection

if TYPE_CHECKING:
    from collections.abc import Sequence

    from beamtouch_service.access import Access
    from beamtouch_service.outputs.section import Output, OutputSection

OUTPUTS: tuple[type[OutputSection], ...] = (ModbusServerSection, MqttSection, OpcUaSection)
"""The only list of outputs: configuration, process and help take them from here.

Not from here: the hint of `beamtouch_common.complaints` that a section belongs in another file."""


def make(section: OutputSection, surfaces: Sequence[str], access: Access) -> Output:
    """Return the output of a section; raises InputError and FailedError, also if one of its libraries is missing."""
    try:
        module = import_module(section.module)
    except ModuleNotFoundError as error:
        library = (error.name or "").partition(".")[0]
        if library.startswith("beamtouch"):
            raise
        message = f"[{section.name}] needs {library}; run: pip install 'beamtouch[service,{section.extra}]'"
        raise InputError(message) from None
    output: Output = module.make(section, surfaces, access)
    return output
