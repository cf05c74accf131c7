"""Quantiles of the normal distribution."""

NORMAL_975 = 1.959964
"""97.5 % quantile; an interval of 95 % reaches this many standard deviations to either side."""
