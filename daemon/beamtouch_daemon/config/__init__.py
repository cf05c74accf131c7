"""The daemon's settings, and the files that hold them: configuration, tare, known modules."""
