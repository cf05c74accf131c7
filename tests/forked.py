"""Commands in processes of their own, forked from a process that has imported their libraries already.

Libraries take half a second of a processor to import, and tests start hundreds of processes. A forked process has
arguments, folder, environment, standard streams and signals of its own, imports the modules of the command anew, and
ends as an interpreter does. The tests of the whole system start each command as a user does.
"""

from __future__ import annotations

import ctypes
import gc
import importlib
import json
import os
import socket
import subprocess
import sys
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

_ADOPT_ORPHANS = 36
"""PR_SET_CHILD_SUBREAPER of prctl(2): what the forking process leaves behind becomes a child of the test process."""
_MAX_REQUEST_BYTES = 150_000


class Parent:
    """A process that has imported the libraries of a command, and forks whenever it is asked to.

    A library that starts a thread when it is imported, as onnxruntime does, cannot be one of them.
    """

    def __init__(self, command: str, *libraries: str) -> None:
        """Start it for the `main` of a module `command`."""
        ctypes.CDLL(None).prctl(_ADOPT_ORPHANS, 1, 0, 0, 0)
        self._control, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            number = theirs.fileno()
            program = [sys.executable, __file__, str(number), command, *libraries]
            self._process = subprocess.Popen(
                program, pass_fds=[number], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End it; its children go on."""
        self._control.close()
        self._process.wait(60)

    def fork(self, arguments: Sequence[str], folder: Path, streams: Sequence[int]) -> int:
        """Return the process id of a new child of this process that runs the command on these descriptors."""
        request = json.dumps([arguments, str(folder), dict(os.environ)])
        socket.send_fds(self._control, [request.encode()], streams)
        return int(self._control.recv(20))


class Forked(subprocess.Popen[str]):
    """A process of a command, forked instead of started; its standard streams are pipes."""

    def __init__(self, parent: Parent, arguments: Sequence[str], folder: Path) -> None:
        self._parent, self._folder = parent, folder
        pipe = subprocess.PIPE
        super().__init__(arguments, stdin=pipe, stdout=pipe, stderr=pipe, text=True)

    def _execute_child(self, args: Sequence[str], *more: int) -> None:
        """Take the place of fork and exec, once the pipes are made."""
        pipes = more[9:15]
        self.pid = self._parent.fork(args, self._folder, (pipes[0], pipes[3], pipes[5]))
        self._child_created = True
        self._close_pipe_fds(*pipes)  # type: ignore[attr-defined]  # private, as this method is


def _serve(control: socket.socket, command: str) -> int:
    """Fork for each request. In the forked process, return what the command returns."""
    while True:
        request, streams, _, _ = socket.recv_fds(control, _MAX_REQUEST_BYTES, 3)
        if not request:
            return 0
        readable, writable = os.pipe()
        between = os.fork()
        if between == 0:
            # Once it has ended, the test process is the parent of its child.
            child = os.fork()
            if child:
                os.write(writable, str(child).encode())
                os._exit(0)
            arguments, folder, environment = json.loads(request)
            for number, stream in enumerate(streams):
                os.dup2(stream, number)
            for descriptor in (*streams, readable, writable):
                os.close(descriptor)
            control.close()
            os.chdir(folder)
            os.environ.clear()
            os.environ.update(environment)
            sys.argv[1:] = arguments
            code: int = importlib.import_module(command).main()
            return code
        os.waitpid(between, 0)
        control.send(os.read(readable, 20))
        for descriptor in (*streams, readable, writable):
            os.close(descriptor)


def _run() -> int:
    number, command, *libraries = sys.argv[1:]
    for library in libraries:
        importlib.import_module(library)
    # What is shared stays shared.
    gc.collect()
    gc.freeze()
    return _serve(socket.socket(fileno=int(number)), command)


if __name__ == "__main__":
    sys.exit(_run())
