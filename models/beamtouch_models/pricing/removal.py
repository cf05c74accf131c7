"""Scenes with a changed value, and scenes without a physical effect."""

from beamtouch_models.scene import Scene


def changed(scene: Scene, part: str, **values: object) -> Scene:
    """Return a scene with other values in one of its parts; raises pydantic's ValidationError if they are invalid."""
    stated = scene.model_dump()
    return Scene.model_validate({**stated, part: {**stated[part], **values}})


def without_shear(scene: Scene) -> Scene:
    """Return the scene without shear."""
    return changed(scene, "beam", shear_modulus_gpa=None)


def without_width(scene: Scene) -> Scene:
    """Return the scene with point contacts."""
    return changed(scene, "contact", width_mm=0.0)


def without_foundation(scene: Scene) -> Scene:
    """Return the scene without its foundation; raises ValidationError if nothing else supports the beam."""
    return changed(scene, "beam", foundation_n_mm2=None)


def without_tolerance(scene: Scene) -> Scene:
    """Return the scene with sensors at exactly known positions."""
    return changed(scene, "sensors", mounting_tolerance_mm=0.0)


def without_adc(scene: Scene) -> Scene:
    """Return the scene without the steps of its ADC."""
    return changed(scene, "sensors", adc_bits=None)


def without_steps(scene: Scene) -> Scene:
    """Return the scene with a prismatic beam that has the mean compliance of the beam."""
    sections = scene.beam.sections
    starts = [0.0, *(section.to_mm for section in sections[:-1])]
    shares = [(section.to_mm - start) / scene.beam.length_mm for section, start in zip(sections, starts, strict=True)]
    compliance = sum(share / section.rigidity_n_mm2 for share, section in zip(shares, sections, strict=True))
    dropped = dict.fromkeys(("youngs_modulus_gpa", "shear_modulus_gpa", "width_mm", "thickness_mm"))
    return changed(scene, "beam", **dropped, segments=(), flexural_rigidity_n_mm2=1 / compliance)
