"""Priors, simulated contacts, the accuracy limit, and the evaluation of models."""
