"""Physics of a beam, up to its influence matrix.

`influence` has the influence function, the only form in which physics leaves this folder for placement, limits and
estimators. `beam` makes one from a scene or from a table. It computes prismatic spans by `closed_forms`, and all other
beams by the elements of `mesh` and `elements`. `motion` is how a beam swings, `axial` how it buckles.
"""
