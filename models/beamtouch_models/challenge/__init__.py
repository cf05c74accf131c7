"""Trial of a model in a simulated world of honest contacts, transients, errors and faults. Pure."""
