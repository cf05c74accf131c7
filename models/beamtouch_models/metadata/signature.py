"""The names of a graph's inputs and outputs."""

INPUTS = ("deflection_mm", "whitening_per_mm")
POSITION_OUTPUTS = ("position_mm", "position_low_mm", "position_high_mm", "contact_log_odds", "misfit")
FORCE_OUTPUTS = ("force_n", "force_low_n", "force_high_n")
