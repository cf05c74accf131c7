"""Placement of the sensors.

`placing` places by a criterion, whose names are in `beamtouch_models.names`. A criterion is an objective: that of
`position_error` knows also how often a layout notices loads that are not one contact; `eigenvalue_product` has the
paper's, from the principal components, and a bound on how much better another layout could be. Each search of `search`
takes any of them. `layout` has the rules for a layout.
"""
