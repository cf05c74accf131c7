"""Reasons why a program cannot listen on an address, with advice."""

from errno import EACCES, EADDRINUSE, EADDRNOTAVAIL


def remedy(error: OSError, option: str) -> str:
    """Return why an address was refused and what to do; `option` is where the user states the port."""
    remedies = {
        EADDRINUSE: f"in use; stop the program that listens there, or choose another port with {option}",
        EACCES: f"not allowed for this user; choose one above 1023 with {option}",
        EADDRNOTAVAIL: "not on this machine; use 127.0.0.1, or an address that `ip address` shows",
    }
    return remedies.get(error.errno or 0, error.strerror or str(error))
