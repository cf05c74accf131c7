"""Trial of a model in a simulated world of honest contacts, transients, errors and faults. Pure.

`contacts` and `faults` have the cases, and `play` what a case is. `judge` takes readings through the daemon's filters
and the model. `challenge` plays all cases, and compares the model's answers with the truth and the goals.
"""
