"""What commands measure: `at_rest` and `tares` for `tare`, `noise` for `noise`, `known_loads` for `record`, and so on.

Pure, but for `known_loads`, which writes the file of a recording. The running daemon imports none of it.
"""
