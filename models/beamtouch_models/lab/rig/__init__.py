"""The rig: a virtual surface served over a real serial line or a real Modbus socket."""
