"""Trial of a model in a simulated world of honest contacts, transients, errors and faults. Pure.

`contacts` and `faults` have the cases, and `play` what a case is. `challenge` plays them all, `judge` takes readings
through the daemon's filters and the model, `scoring` compares its answers with the truth and the goals.
"""
