"""A plant as real processes: rigs, a daemon, services that share the surfaces, HAProxy and PostgreSQL."""

import signal
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import tomli_w

from line import Line, Surface
from support.network.balancer import Balancer, answers
from support.network.free_ports import free_port
from support.running.waiting import wait_until


class PlantLine(Line):
    """A line with several services behind a balancer; `Line` has the parameters.

    Parameters
    ----------
    events_url : database of the events
    services : number of services
    """

    def __init__(
        self,
        folder: Path,
        scene: Path,
        model: Path,
        daemon_config: Path,
        surfaces: Sequence[Surface],
        *,
        events_url: str,
        services: int,
    ) -> None:
        super().__init__(folder, scene, model, daemon_config, surfaces)
        self.services = [f"service-{number}" for number in range(services)]
        self._ports = {name: free_port() for name in self.services}
        self._events_url = events_url
        self.disturbed = "nothing"
        """What is being killed, frozen or restarted."""
        self.balancer = Balancer(folder, list(self._ports.values()))

    def stop(self) -> None:
        """End all processes."""
        try:
            super().stop()
        finally:
            self.balancer.stop()

    def wait_for_services(self) -> None:
        """Wait until each service answers."""
        for name in self.services:
            wait_until(partial(answers, self.address(name)), within_s=300)

    def address(self, service: str) -> str:
        """Return the URL of one service."""
        return f"http://127.0.0.1:{self._ports[service]}"

    def kill(self, service: str) -> None:
        """Kill a service, and start it again, as systemd does a second later."""
        process = self._processes.pop(service)
        process.kill()
        process.wait()
        time.sleep(1)
        self._start_one(service)

    def freeze(self, service: str, seconds: float) -> None:
        """Let a service stand still for a while."""
        process = self._processes[service]
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)

    def _start_service(self, port: int = 0) -> str:  # noqa: ARG002  # each has its own
        surfaces = {surface.name: {"model": str(self._model)} for surface in self.surfaces}
        server = {"replica": True, "write_token_file": "token"}
        config = {"server": server, "events": {"url": self._events_url}, "surfaces": surfaces}
        (self.folder / "service.toml").write_text(tomli_w.dumps(config))
        for name in self.services:
            self._start_one(name)
        self.wait_for_services()
        self.balancer.start()
        return self.balancer.url

    def _start_one(self, name: str) -> None:
        port = str(self._ports[name])
        self._start(name, ["beamtouch-service", "run", "--config", str(self.folder / "service.toml"), "--port", port])
