"""The schemas in `docs/schemas`, which editors and clients use, state the bounds and defaults of the programs."""

import json
from typing import Any

import pytest
from pydantic import BaseModel

import facts
from beamtouch_common.zones import Zone
from beamtouch_daemon.config.publish import Publish
from beamtouch_daemon.config.settings import Config, Loads, Metrics, Surface
from beamtouch_daemon.config.signal import Channel, GrowingMean, MovingAverage, ZeroTracking
from beamtouch_daemon.config.sources import ModbusRtu, ModbusTcp, SerialLine
from beamtouch_models.design.scene import Scene
from beamtouch_models.design.scene.beam import Beam
from beamtouch_models.design.scene.measured import Measured
from beamtouch_models.design.scene.plate import Plate
from beamtouch_models.design.scene.schema import editor_schema
from beamtouch_models.design.scene.tables import Contact, Environment, Requirements, Sensors
from beamtouch_models.lab.rig.loads import Script, Step
from beamtouch_models.lab.rig.surface import Imperfections
from beamtouch_models.runtime.departures import Departures
from beamtouch_service.config import ConfigFile
from beamtouch_service.outputs.modbus.section import ModbusServerSection
from beamtouch_service.outputs.mqtt.section import MqttSection
from beamtouch_service.outputs.opcua.section import OpcUaSection
from beamtouch_service.samples import Batch, Receipt, Sample
from beamtouch_service.sections import EventsSection, ServerSection, SurfaceSection
from support.pages.pasted import ROOT

WHOLE: dict[str, type[BaseModel]] = {
    "daemon": Config,
    "scene": Scene,
    "service": ConfigFile,
    "rig-script": Script,
    "rig-imperfections": Imperfections,
}
PARTS: dict[str, list[type[BaseModel]]] = {
    "daemon": [
        *(Channel, GrowingMean, Loads, Metrics, ModbusRtu, ModbusTcp, MovingAverage, Publish, SerialLine, Surface),
        ZeroTracking,
    ],
    "scene": [Beam, Contact, Environment, Measured, Plate, Requirements, Sensors],
    "service": [
        *(EventsSection, ModbusServerSection, MqttSection, OpcUaSection, ServerSection, SurfaceSection, Zone),
    ],
    "rig-script": [Step],
}


def committed(name: str) -> dict[str, Any]:
    schema: dict[str, Any] = json.loads((ROOT / "docs" / "schemas" / f"{name}.json").read_text())
    return schema


@pytest.mark.parametrize("name", WHOLE)
def test_the_schema_of_a_file_is_that_of_the_program(name: str) -> None:
    made, stated = editor_schema(WHOLE[name], ""), committed(name)
    assert made["properties"] == stated["properties"]
    assert made.get("$defs") == stated.get("$defs")


@pytest.mark.parametrize(("name", "part"), [(name, part) for name, parts in PARTS.items() for part in parts])
def test_the_schema_of_a_section_is_that_of_the_program(name: str, part: type[BaseModel]) -> None:
    made = json.loads(json.dumps(editor_schema(part, "")))
    assert made["properties"] == committed(name)["$defs"][part.__name__]["properties"]


@pytest.mark.parametrize("part", [Batch, Departures, Receipt, Sample])
def test_the_schema_of_what_is_sent_is_that_of_the_program(part: type[BaseModel]) -> None:
    made = part.model_json_schema(ref_template="#/components/schemas/{model}")
    stated = committed("openapi")["components"]["schemas"][part.__name__]
    assert without_null(made["properties"]) == without_null(stated["properties"])


def without_null(members: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return members without a default of nothing, which the description of an answer leaves out."""
    return {
        name: {key: value for key, value in member.items() if (key, value) != ("default", None)}
        for name, member in members.items()
    }


def test_the_description_of_the_service_is_that_of_the_program() -> None:
    assert json.loads(json.dumps(facts.openapi())) == committed("openapi")
