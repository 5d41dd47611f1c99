"""The embedding of a component: the stages in order, the certificate and the evidence."""

import time

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.domain import ConformalHoles, Sphere
from ostiform.embedding.area_targets import part_scales
from ostiform.embedding.certificate import certify
from ostiform.embedding.closed import punctured_start
from ostiform.embedding.conformal import conformal_holes
from ostiform.embedding.continuation import Continued, continued
from ostiform.embedding.distortion import measure_distortion
from ostiform.embedding.newton import MovingRim, map_problem
from ostiform.embedding.paper import harmonic_embedding
from ostiform.embedding.placed_curves import placed_curves
from ostiform.embedding.pose_fit import best_rotation, posed_moments
from ostiform.embedding.reference import surface_reference
from ostiform.embedding.seam_warp import seams_on_circles
from ostiform.embedding.settings import EmbeddingSettings
from ostiform.embedding.start import on_curves, starting_map, state
from ostiform.embedding.types import Embedding, EmbeddingState
from ostiform.embedding.untangle import untangled
from ostiform.errors import EmbeddingError
from ostiform.surface import Component, Seam, count_flipped, sphere_locator, spherical_areas


def embed(
    component: Component,
    sphere: Sphere,
    settings: EmbeddingSettings | None = None,
    pose: FloatArray | None = None,
    holes: ConformalHoles | None = None,
) -> Embedding:
    """Map a component to its sphere (HY 2.1, 2.2; design 3).

    Parameters
    ----------
    component : Component
        After hygiene (`ostiform.surface.hygiene.cleaned_for_embedding`).
    sphere : Sphere
        The circles of its rims and seams.
    settings : EmbeddingSettings, optional
    pose : (4, 4) float64, optional
        Input to aligned coordinates, column vectors: fixes what rotation the circles leave free.
        The identity by default.
    holes : ConformalHoles, optional
        Of `conformal_holes` for this component, pole and pose, where they are known already.

    Returns
    -------
    Embedding
        With the states on the way, the certificate (whether it may be used) and the distortion.

    Raises
    ------
    EmbeddingError
        If no map without folds could be made to start from.
    """
    settings = settings or EmbeddingSettings()
    pose = np.eye(4) if pose is None else pose
    clock = time.process_time()
    if not component.rims and not component.seams:
        directions, states = _closed(component, settings, pose)
    else:
        directions, states = _open(component, sphere, settings, pose)
    certificate = certify(component, sphere, directions)
    holes = conformal_holes(component, sphere.pole, pose) if holes is None else holes
    distortion = measure_distortion(component, sphere, directions, holes)
    return Embedding(
        component=component,
        locator=sphere_locator(directions, component.faces),
        curves=placed_curves(component, sphere, directions) if certificate.is_valid else {},
        certificate=certificate,
        distortion=distortion,
        states=tuple(states),
        method=settings.method,
        seconds=time.process_time() - clock,
    )


def _open(
    component: Component, sphere: Sphere, settings: EmbeddingSettings, pose: FloatArray
) -> tuple[FloatArray, list[EmbeddingState]]:
    start = starting_map(component, sphere, pose)
    if start.folded:
        raise EmbeddingError(
            f"{component.name}: expected a start without folds, found {start.folded} of "
            f"{len(component.faces)} triangles folded after untangling: remesh the surface, or "
            "move its circles apart"
        )
    if start.degree != 1:
        raise EmbeddingError(
            f"{component.name}: expected a start that covers the sphere once, found one that "
            f"covers it {start.degree} times: order the circles as the openings are on the surface"
        )
    states = list(start.states)
    if settings.method == "harmonic":
        curves = placed_curves(component, sphere, start.directions)
        rotations = {name: curve.first_angle for name, curve in curves.items()}
        paper = harmonic_embedding(component, sphere, rotations=rotations, start=start.directions)
        return paper.directions, [*states, *paper.states]
    clock = time.process_time()
    free_seams = _minimised(component, sphere, settings, start.directions, ())
    directions = free_seams.directions
    if component.seams:
        states.append(state("joint", component, directions, time.process_time() - clock))
        clock = time.process_time()
        directions = seams_on_circles(component, sphere, directions)
        if count_flipped(directions, component.faces):
            directions = untangled(directions, component.faces, on_curves(component)).directions
        if count_flipped(directions, component.faces):
            seams = tuple(component.seams)
            directions = _minimised(component, sphere, settings, start.directions, seams).directions
    states.append(state("conformal", component, directions, time.process_time() - clock))
    return directions, states


def _minimised(
    component: Component,
    sphere: Sphere,
    settings: EmbeddingSettings,
    directions: FloatArray,
    turning_seams: tuple[Seam, ...],
) -> Continued:
    """Minimise with every rim turning on its circle; seams are free curves or turn likewise."""
    curves = [(sphere.rims[name], rim) for name, rim in component.rims.items()]
    curves += [(sphere.seams[seam], component.seams[seam]) for seam in turning_seams]
    rims = [MovingRim(loop, circle, circle.angles(directions[loop])) for circle, loop in curves]
    is_fixed = np.zeros(len(directions), dtype=np.bool_)
    for _, loop in curves:
        is_fixed[loop] = True
    scales = part_scales(component, sphere, directions)
    return _continued(component, settings, directions, is_fixed, rims, scales)


def _continued(
    component: Component,
    settings: EmbeddingSettings,
    directions: FloatArray,
    is_fixed: BoolArray,
    rims: list[MovingRim],
    scales: FloatArray | None = None,
) -> Continued:
    area = float(spherical_areas(directions, component.faces).sum())
    reference = surface_reference(component.vertices, component.faces, area, scales)
    problem = map_problem(component.faces, reference, is_fixed, rims)
    return continued(
        problem,
        directions,
        settings.weights,
        is_fixed,
        settings.tolerance,
        settings.max_iterations,
    )


def _closed(
    component: Component, settings: EmbeddingSettings, pose: FloatArray
) -> tuple[FloatArray, list[EmbeddingState]]:
    clock = time.process_time()
    tutte = punctured_start(component.vertices, component.faces)
    states = [state("tutte", component, tutte, time.process_time() - clock)]
    clock = time.process_time()
    is_fixed = np.zeros(len(tutte), dtype=np.bool_)
    start = untangled(tutte, component.faces, is_fixed)
    if start.folded:
        raise EmbeddingError(
            f"{component.name}: expected a start without folds, found {start.folded} of "
            f"{len(component.faces)} triangles folded after untangling: remesh the surface"
        )
    states.append(state("untangled", component, start.directions, time.process_time() - clock))
    clock = time.process_time()
    result = _continued(component, settings, start.directions, is_fixed, [])
    moments = posed_moments(component.vertices, component.faces, result.directions, pose)
    directions = result.directions @ best_rotation(moments).T
    states.append(state("conformal", component, directions, time.process_time() - clock))
    return directions, states
