"""What plain HTTP requests of tests share."""

import ssl

NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""For `verify=`: without it, each request loads all certificates of the machine, which takes 20 ms of a core."""
TIMEOUT_S = 60.0
"""For an answer from a service on a machine that is busy with other work; the default of 5 s is too short there."""
