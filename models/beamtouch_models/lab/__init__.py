"""Simulations of the real world: the rig, challenges of a model, the trade of its figures, the paper's reproduction."""
