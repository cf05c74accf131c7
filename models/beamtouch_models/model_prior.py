"""What a model was made from, out of its own file."""

import numpy as np

from beamtouch_models.effects import required
from beamtouch_models.modelfile import Metadata
from beamtouch_models.prior import Prior
from beamtouch_models.scene import parse_scene


def prior_of_model(metadata: Metadata) -> Prior:
    """Rebuild the prior of a model; raises SceneError where its scene is not one."""
    physics = required(parse_scene(metadata.scene, f"the scene in {metadata.name}"))
    sensor_mm = np.array([channel.position_mm for channel in metadata.layout])
    return Prior.of(physics, sensor_mm, metadata.noise.sample_mm)
