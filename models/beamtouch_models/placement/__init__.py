"""Placement of the sensors.

`placing` places by a criterion, whose names are in `beamtouch_models.names`. A criterion is an objective,
`position_error` or `eigenvalue_product`, and each search of `search` takes any of them. `layout` has the rules for a
layout, `noticing` says how often one notices loads that are not one contact, and `bound` how much better another could
be.
"""
