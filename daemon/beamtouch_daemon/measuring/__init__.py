"""Measurements that only commands make: rest (`at_rest`, `tares`), `noise`, `known_loads`, `byte_orders`.

Pure, but for `known_loads`, which writes the file of a recording. The running daemon imports none of it.
"""
