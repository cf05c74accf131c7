"""The daemon on a terminal of its own, which another program answers."""

import os
import subprocess
import sys

TAKES_TERMINAL = "import fcntl, sys, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)"
"""Makes the terminal the one whose Ctrl-C interrupts the process, as at a login."""
MAIN = "from beamtouch_daemon.cli import main; sys.exit(main())"


def at_terminal(words: list[str], answers: dict[str, list[str]]) -> tuple[int, str]:
    """Run the daemon; answer each question that contains a key with the next of its answers.

    Returns the exit code and everything that the terminal showed.
    """
    near, far = os.openpty()
    program = [sys.executable, "-c", f"{TAKES_TERMINAL}; {MAIN}", *words]
    said, asked = "", 0
    with subprocess.Popen(program, stdin=far, stdout=far, stderr=far, start_new_session=True) as process:
        os.close(far)
        try:
            while True:
                said += os.read(near, 4096).decode()
                question = said[asked:].rpartition("\n")[2]
                if question.endswith(": "):
                    (key,) = (key for key in answers if key in question)
                    asked = len(said)
                    os.write(near, f"{answers[key].pop(0)}\n".encode())
        except OSError:  # the terminal is gone when the process has ended
            return process.wait(60), said
        finally:
            process.kill()
            os.close(near)
