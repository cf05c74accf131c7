"""From a scene to one deployable model file: physics, sensor placement, estimators, and the virtual rig."""

import os

# Unless told otherwise before it is imported, onnxruntime writes an identifier into the home folder and reports its use
# to its maker over the network. Whoever wants that sets the variable to 0.
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
