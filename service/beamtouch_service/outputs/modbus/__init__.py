"""Contacts as Modbus input registers, for controllers that know no HTTP. Knows no socket and no clock."""
