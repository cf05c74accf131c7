"""Contacts as Modbus input registers, for controllers that know no HTTP. Only `server` knows sockets and the clock."""
