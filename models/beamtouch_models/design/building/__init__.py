"""The build: from a scene to a model file, with its report."""
