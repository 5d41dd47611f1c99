"""Components finer than a template can use are meshed anew, before they are mapped.

A map costs more than its vertices (and far more where triangles are slivers), and what lies between
two points of the template is not seen by the model. The original stays what results are measured
against.
"""

from ostiform.surface.queries import closest_points, surface_tree
from ostiform.surface.remesh import isotropic_remeshed
from ostiform.surface.types import Component


def coarsened(component: Component, most_vertices: int) -> tuple[Component, float]:
    """Return a component of few enough vertices, and how far the original is from it.

    Vertices lie on the original, those of rims and seams on its rims and seams.

    Parameters
    ----------
    component : Component
    most_vertices : int
        A component with more is meshed anew with about as many, evenly.

    Returns
    -------
    component : Component
        The same object where it has few enough.
    distance : float, mm
        The largest of a vertex of the original to the result; 0 where it is the same object.

    Raises
    ------
    ConvergenceError
        If its rims and seams alone need more vertices.
    """
    if len(component.vertices) <= most_vertices:
        return component, 0.0
    n_rims = len(component.rims)
    fine = isotropic_remeshed(
        component.vertices,
        component.faces,
        n_vertices=most_vertices,
        curves=(*component.rims.values(), *component.seams.values()),
        labels=component.face_part,
    )
    coarse = Component(
        component.name,
        component.parts,
        fine.vertices,
        fine.faces,
        fine.labels,
        dict(zip(component.rims, fine.curves[:n_rims], strict=True)),
        dict(zip(component.seams, fine.curves[n_rims:], strict=True)),
    )
    found = closest_points(surface_tree(coarse.vertices, coarse.faces), component.vertices)
    return coarse, float(found.distances.max())
