"""The commands of `beamtouch-daemon`, a module each: init, scan, check, tare, noise, record, run."""
