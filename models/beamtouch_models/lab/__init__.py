"""What plays the real world: the rig, the challenge of a model, the trade of its figures, the paper's reproduction."""
