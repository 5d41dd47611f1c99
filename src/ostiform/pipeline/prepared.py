"""A shape prepared for its maps, and where it is kept.

Artifacts: ``shapes/NAME.bin``.
"""

from pathlib import Path

from ostiform.artifacts import load_mapped
from ostiform.domain import ComponentOutline, outlined
from ostiform.study import Shape
from ostiform.surface import Component, cleaned_for_embedding, welded_components
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


def prepared_shape(shape: Shape) -> PreparedShape:
    """Weld the parts of a shape and make its components fit for embedding.

    Raises
    ------
    TopologyError
        If a component cannot be mapped to a sphere.
    """
    welded = welded_components(shape.parts, shape.seams)
    cleaned = [cleaned_for_embedding(component) for component in welded]
    return PreparedShape(
        shape,
        tuple(component for component, _ in cleaned),
        tuple(outlined(component) for component in welded),
        tuple(repair for _, repairs in cleaned for repair in repairs),
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
