"""Requests without TLS."""

import ssl

NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""For `verify=`: without it, each request loads all certificates of the machine, which takes 20 ms of a core."""
