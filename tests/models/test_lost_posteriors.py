"""Contacts that a layout cannot tell: samples so far from any contact that likelihoods nearly vanish."""

import numpy as np
import pytest

from beamtouch_models.design.placement.mean_error import MeanError

OFF = 37.65
"""Deviations of a sample beyond the largest force. The normal distribution leaves 1e-310 beyond, and the reciprocal of
that overflows."""


def test_a_sample_next_to_no_contact_may_come_from_any_place() -> None:
    edges_mm, one = np.arange(5.0), np.ones((1, 1))
    lost = MeanError((1.0, 2.0), [edges_mm], np.ones((4, 1)), (2.0 + OFF) * one, one, one, np.ones(1))
    # Places spread evenly over 4 mm, from their median in the middle.
    assert lost.along_mm(np.array([0])) == pytest.approx([1.5, 0.5, 0.5, 1.5])
