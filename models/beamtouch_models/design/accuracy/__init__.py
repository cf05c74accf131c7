"""Priors and posteriors, simulated contacts, the accuracy limit, thresholds, and the evaluation of models.

`limit` also draws the contacts, and has the Cramer-Rao bound.
"""
