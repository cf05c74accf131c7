"""The daemon's settings, and the files that hold them: configuration, tare, known modules.

`settings` has a surface as a whole; `sources` its device, `signal` its filter, zero tracking and channels, `publish`
the service. A new kind of source or filter is a class in the union there.
"""
