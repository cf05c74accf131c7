"""Placement of the sensors.

`placing` places by a criterion, whose names are in `beamtouch_models.names`. A criterion is an objective: in
`position_error`, also for how often a layout notices loads that are not one contact, or in `eigenvalue_product`, with a
bound on how much better another layout could be. Each search of `search` takes any of them. `layout` has the rules for
a layout.
"""
