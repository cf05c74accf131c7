"""The commands of the command line, a module each: run, check, tare, record, noise."""
