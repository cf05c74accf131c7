"""From a scene to one deployable model file: physics, sensor placement, estimators, and the virtual rig."""
