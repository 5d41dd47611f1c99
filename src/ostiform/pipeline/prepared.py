"""A shape prepared for its maps, and where it is kept.

Artifacts: ``shapes/NAME.bin``.
"""

from pathlib import Path

from ostiform.artifacts import load_mapped
from ostiform.domain import ComponentOutline, outlined
from ostiform.study import Shape
from ostiform.surface import Component, cleaned_for_embedding, coarsened, welded_components
from ostiform.values import value


@value
class PreparedShape:
    """A shape with named openings and the components that are mapped.

    Attributes
    ----------
    shape : Shape
        Its surfaces as read, in input coordinates.
    components : tuple of Component
        Welded at the seams and fit for embedding.
    outlines : tuple of ComponentOutline
        Of the components as welded.
    repairs : tuple of str
        What was changed to make them fit, one sentence each.
    """

    shape: Shape
    components: tuple[Component, ...]
    outlines: tuple[ComponentOutline, ...]
    repairs: tuple[str, ...]


def prepared_shape(shape: Shape, finest: int | None) -> PreparedShape:
    """Weld the parts of a shape and make its components fit for embedding.

    Parameters
    ----------
    shape : Shape
    finest : int or None
        A component with more vertices than so many for each of its parts is meshed anew with fewer.

    Raises
    ------
    TopologyError
        If a component cannot be mapped to a sphere.
    """
    welded = welded_components(shape.parts, shape.seams)
    cleaned = [cleaned_for_embedding(component) for component in welded]
    components = [component for component, _ in cleaned]
    repairs = [repair for _, repairs in cleaned for repair in repairs]
    for place, component in enumerate(components):
        if finest is None:
            continue
        coarse, distance = coarsened(component, finest * len(component.parts))
        if coarse is not component:
            components[place] = coarse
            repairs.append(
                f"{component.name} meshed anew for its map, {len(component.vertices):,} -> "
                f"{len(coarse.vertices):,} vertices, at most {distance:.2g} mm away"
            )
    return PreparedShape(
        shape,
        tuple(components),
        tuple(outlined(component) for component in welded),
        tuple(repairs),
    )


def shape_artifact(name: str) -> str:
    """Return the artifact of a prepared shape."""
    return f"shapes/{name}.bin"


def read_prepared(path: Path) -> PreparedShape:
    """Return a prepared shape, its arrays mapped from the file.

    Raises
    ------
    ArtifactError
        If the file is missing or damaged.
    """
    return load_mapped(path, PreparedShape)


def read_shape(path: Path) -> Shape:
    """Return the surfaces of a prepared shape. Errors are those of `read_prepared`."""
    return read_prepared(path).shape
