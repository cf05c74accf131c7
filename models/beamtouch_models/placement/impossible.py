"""The errors for layouts that cannot be."""

from beamtouch_models.errors import SceneError


def no_layout(count: int) -> SceneError:
    """Return the error for rules that allow no layout."""
    return SceneError(
        f"no layout of {count} sensors keeps the rules of sensors (size_mm, min_distance_mm, keep_out_mm, "
        "fixed_mm, grid_mm, mounting_tolerance_mm); loosen one or use fewer sensors"
    )


def too_few_components(count: int, leading: int) -> SceneError:
    """Return the error for more components than sensors."""
    return SceneError(f"{count} sensors have {count} components, not {leading}; use fewer components or more sensors")
