"""Names and addresses of hosts."""


def host_name(text: str) -> str:
    """Return the name or address of a host; ValueError if no host can have it."""
    try:
        text.encode("idna")
    except UnicodeError:
        is_name = False
    else:
        is_name = bool(text) and text.isprintable() and " " not in text
    if not is_name:
        message = "must be the name or address of a host"
        raise ValueError(message)
    return text
