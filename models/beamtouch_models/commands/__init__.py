"""The commands of `design-sensors`: one module each, whose `run` reads files, calls the other folders and writes."""
