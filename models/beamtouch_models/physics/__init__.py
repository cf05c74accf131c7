"""Physics of a beam, up to its influence matrix."""
