"""A file of another kind is named, where it is clear that it is one."""

from typing import Any

import pytest

from beamtouch_common.file_kinds import mistaken_kind
from beamtouch_daemon.config.settings import Config
from beamtouch_models.rig.script import Script
from beamtouch_models.scene import Scene
from beamtouch_service.config import Settings

DAEMON: dict[str, Any] = {"publish": {}, "surfaces": {"bench": {"source": {}}}}
SERVICE: dict[str, Any] = {"surfaces": {"bench": {"model": "bench.onnx"}}}
SCENE: dict[str, Any] = {"beam": {}, "contact": {}}


@pytest.mark.parametrize(
    ("kind", "content", "said"),
    [
        (Scene, DAEMON, "this is a configuration of the daemon; give a scene"),
        (Config, SCENE, "this is a scene; give a configuration of the daemon"),
        (Config, SERVICE, "this is a configuration of the service; give a configuration of the daemon"),
        (Settings, DAEMON, "this is a configuration of the daemon; give a configuration of the service"),
        (Settings, {"step": []}, "this is a script of the rig; give a configuration of the service"),
        (Script, SCENE, "this is a scene; give a script of the rig"),
    ],
)
def test_a_file_of_another_kind_is_named(kind: type, content: dict[str, Any], said: str) -> None:
    assert mistaken_kind(kind, content) == said


@pytest.mark.parametrize(
    ("kind", "content"),
    [
        (Scene, SCENE),
        (Scene, {}),
        (Scene, {"beem": {}}),
        (Scene, SCENE | {"server": {}}),
        (Settings, SERVICE | {"publish": {}}),
        (Settings, {"surfaces": "bench"}),
        (Config, DAEMON | SCENE),
    ],
)
def test_a_mixture_or_a_misspelt_key_is_not_another_kind(kind: type, content: dict[str, Any]) -> None:
    assert mistaken_kind(kind, content) == ""
