"""The paper's chain, step by step (HY 2.1, 2.2, Fig. 2): for the report and as a checked mode.

1. ``tutte``: rims on their circles by arc length, the interior by Tutte's method in the
   stereographic plane; folded round every opening (HY Fig. 2a).
2. ``untangled``: the minimum area round every vertex maximised (eq. 1). Where it fails and another
   fold-free start is at hand, that one is taken, as the state ``start``, and a note says so.
3. ``smoothed``: Laplacian smoothing accepted only where the quality of eq. 2 improves.
4. ``harmonic``: the descent of eq. 3 and 4, to a map that is folded wherever a circle is wider
   than about twice its conformal radius (`harmonic.fold_explanations`).

Every state keeps the number of its folded triangles; nothing here judges them.
"""

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ostiform.arrays import BoolArray, FloatArray
from ostiform.domain import Sphere
from ostiform.embedding.fixed_circle_tutte import PlanarChart, fixed_circle_charts, on_sphere
from ostiform.embedding.harmonic import Descent, HarmonicResult, harmonic_map
from ostiform.embedding.maxmin import LocalSolver, MaxMinResult, MaxMinStatus, untangled_by_area
from ostiform.embedding.smoothing import smoothed_where_better
from ostiform.embedding.types import EmbeddingState
from ostiform.surface import Component, count_flipped
from ostiform.values import Axes, value


@dataclass(frozen=True, slots=True)
class PaperSettings:
    """How far each step of the paper's chain is taken.

    Attributes
    ----------
    untangling : str
        Local solver of eq. 1: ``"conjugate-gradient"`` (HY) or ``"linear-program"`` (exact).
    max_untangling_sweeps, max_smoothing_sweeps : int
        Passes over all vertices.
    descent : str
        ``"explicit"`` (HY eq. 4) or ``"semi-implicit"``.
    max_iterations : int
        Of the descent.
    tolerance : float
        Relative decrease of the energy in one iteration at which the descent ends.
    """

    untangling: LocalSolver = "conjugate-gradient"
    max_untangling_sweeps: int = 300
    max_smoothing_sweeps: int = 20
    descent: Descent = "semi-implicit"
    max_iterations: int = 2000
    tolerance: float = 1e-9


@value
class PaperEmbedding:
    """The result of the paper's chain.

    Attributes
    ----------
    directions : (V, 3) float64
        Unit vectors; folded or not.
    states : tuple of EmbeddingState
        The steps in order; the last equals `directions`.
    rotations : mapping of str to float
        Angle on its circle, in radians, of the first vertex of each rim and seam.
    harmonic : HarmonicResult
        With the energies of the descent and why it stopped.
    notes : tuple of str
        One sentence for every step that did not do what HY expect of it.
    """

    directions: Annotated[FloatArray, Axes("V", 3)]
    states: tuple[EmbeddingState, ...]
    rotations: Mapping[str, float]
    harmonic: HarmonicResult
    notes: tuple[str, ...]


def harmonic_embedding(
    component: Component,
    sphere: Sphere,
    settings: PaperSettings | None = None,
    rotations: Mapping[str, float] | None = None,
    start: FloatArray | None = None,
) -> PaperEmbedding:
    """Map a component to its sphere by the paper's chain (HY 2.1, 2.2).

    Parameters
    ----------
    component : Component
        After hygiene: without edges that join two rim vertices.
    sphere : Sphere
    settings : PaperSettings, optional
    rotations : mapping of str to float, optional
        Angle on its circle of the first vertex of each rim and seam; those of `start` by
        default, without one the phases of the circles.
    start : (V, 3) float64, optional
        A fold-free map with the rims and seams on their circles, taken where the untangling
        fails.

    Raises
    ------
    InputError
        If a part has no opening to be projected from.
    """
    settings = settings or PaperSettings()
    if rotations is None:
        rotations = _rotations(component, sphere, start)
    is_fixed = _on_curves(component)
    states: list[EmbeddingState] = []
    notes: list[str] = []
    clock = time.perf_counter()
    charts = fixed_circle_charts(component, sphere, rotations)
    directions = on_sphere(charts, len(component.vertices))
    clock = _recorded(states, "tutte", component, directions, clock)

    results = tuple(_untangled(chart, settings) for chart in charts)
    charts = tuple(
        replace(chart, points=result.points) for chart, result in zip(charts, results, strict=True)
    )
    directions = on_sphere(charts, len(component.vertices))
    clock = _recorded(states, "untangled", component, directions, clock)
    notes += [
        f"{part}: expected the untangling (HY eq. 1) to leave no folded triangle, found "
        f"{result.folded} of {len(chart.faces)} after {result.sweeps} sweeps: "
        f"{result.status.value}"
        for part, chart, result in zip(component.parts, charts, results, strict=True)
        if result.status is not MaxMinStatus.UNTANGLED
    ]
    if states[-1].flipped and all(r.status is MaxMinStatus.UNTANGLED for r in results):
        notes.append(
            f"{component.name}: expected the untangled plane map to have no folds on the sphere, "
            f"found {states[-1].flipped} triangles so large or flat that their chords fold"
        )
    if states[-1].flipped and start is not None:
        directions = start
        clock = _recorded(states, "start", component, directions, clock)
        notes.append(
            f"{component.name}: the map with filled holes replaces the untangled one, which still "
            f"has {states[-2].flipped} folded triangles"
        )
        rotations = _rotations(component, sphere, start)

    smoothed = smoothed_where_better(
        directions, component.faces, is_fixed, settings.max_smoothing_sweeps
    )
    clock = _recorded(states, "smoothed", component, smoothed.directions, clock)
    harmonic = harmonic_map(
        component,
        smoothed.directions,
        is_fixed,
        settings.descent,
        settings.max_iterations,
        settings.tolerance,
    )
    _recorded(states, "harmonic", component, harmonic.directions, clock)
    if harmonic.folded:
        notes.append(
            f"{component.name}: expected the harmonic map (HY eq. 3, 4) to be free of folds, found "
            f"{harmonic.folded} of {len(component.faces)} triangles folded after "
            f"{harmonic.iterations} iterations: {harmonic.status.value}"
        )
    return PaperEmbedding(harmonic.directions, tuple(states), rotations, harmonic, tuple(notes))


def paper_states(
    component: Component,
    sphere: Sphere,
    rotations: Mapping[str, float] | None = None,
    start: FloatArray | None = None,
) -> tuple[EmbeddingState, ...]:
    """Return the states of the paper's chain with its default settings (HY Fig. 2).

    Parameters are those of `harmonic_embedding`.
    """
    return harmonic_embedding(component, sphere, None, rotations, start).states


def _recorded(
    states: list[EmbeddingState],
    name: str,
    component: Component,
    directions: FloatArray,
    clock: float,
) -> float:
    """Append a state that took the time since `clock`; return the time now."""
    seconds = time.perf_counter() - clock
    folded = count_flipped(directions, component.faces)
    states.append(EmbeddingState(name, directions, folded, seconds))
    return time.perf_counter()


def _untangled(chart: PlanarChart, settings: PaperSettings) -> MaxMinResult:
    return untangled_by_area(
        chart.points,
        chart.faces,
        chart.is_fixed,
        settings.max_untangling_sweeps,
        settings.untangling,
    )


def _on_curves(component: Component) -> BoolArray:
    on_curve = np.zeros(len(component.vertices), dtype=np.bool_)
    for curve in (*component.rims.values(), *component.seams.values()):
        on_curve[curve] = True
    return on_curve


def _rotations(component: Component, sphere: Sphere, start: FloatArray | None) -> dict[str, float]:
    """Angle of the first vertex of each curve in a map, or the phases of the circles."""
    curves = [(name, sphere.rims[name], rim[0]) for name, rim in component.rims.items()]
    curves += [(s.first, sphere.seams[s], curve[0]) for s, curve in component.seams.items()]
    return {
        name: circle.phase if start is None else float(circle.angles(start[first]))
        for name, circle, first in curves
    }
