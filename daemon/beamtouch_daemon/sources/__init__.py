"""Devices and buses: bytes to readings.

A reading comes through these modules, from the surface to the wire:

- Modbus TCP: `polled`, `modbus_tcp`, `host_address`
- Modbus RTU: `polled`, `rtu_bus`, `rtu_unit` (is the answer new?), `rtu_line` (one request at a time), `serial_port`
- the serial protocol: `board`, `serial_port`

In place of a serial port, `converter` leads to a serial line over TCP. `requests` counts the requests of a unit that
fail, and asks again where that may help. `kept_port` keeps a port open between sessions, and `traffic` says what came
through it that is no frame.

A new kind of source has its settings in `config/sources.py`, a module here, and its case in `configured`.
`Surface.place_of` in `config/settings.py` says where its channels are.
"""
