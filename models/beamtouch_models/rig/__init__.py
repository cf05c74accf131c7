"""The rig: a virtual surface behind a real serial line or a real Modbus socket."""
