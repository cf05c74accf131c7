"""From a scene to a model file, and its calibration: physics, accuracy, placement, estimators, what `build` writes."""
