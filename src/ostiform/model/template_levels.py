"""A model on the nested coarser triangulations of its template."""

import numpy as np

from ostiform.domain import Template, TemplateLevel
from ostiform.errors import InputError
from ostiform.model.mesh import mesh_of_template
from ostiform.model.resampling import carried_weights, point_density
from ostiform.model.types import StoredModel


def at_level(stored: StoredModel, level: int) -> StoredModel:
    """Return the model on one of the nested coarser triangulations of its template.

    The points are some of the model's own; their weights are their area shares on the coarser
    mesh of the mean. The scores are those of the same shapes in the new modes.

    Parameters
    ----------
    stored : StoredModel
    level : int
        From 0, the coarsest.

    Raises
    ------
    InputError
        If there is no template or it has no such level.
    """
    template = stored.template
    n_levels = 0 if template is None else len(template.levels)
    if template is None or not 0 <= level < n_levels:
        raise InputError(
            "level of a model: expected a model whose template has the level, from 0 to "
            f"{n_levels - 1}, found {level}"
            if n_levels
            else "level of a model: expected a template with coarser levels, found none; use "
            "resampled instead"
        )
    coarse = _level_template(template, level)
    index = template.levels[level].index
    model = stored.model
    mesh, mean = mesh_of_template(coarse), model.mean[index]
    density = point_density(model.mean, model.mesh, model.weights)[index]
    new = model.image(mean, model.modes[:, index], carried_weights(mean, mesh.faces, density), mesh)
    shapes = model.reconstruct(stored.scores)[:, index]
    return StoredModel(new, new.project(shapes), stored.ids, coarse)


def _level_template(template: Template, level: int) -> Template:
    chosen = template.levels[level]
    place = np.full(len(template.points), -1, dtype=np.int64)
    place[chosen.index] = np.arange(len(chosen.index))
    return Template(
        points=template.points[chosen.index],
        sphere=template.sphere[chosen.index],
        part=template.part[chosen.index],
        faces=chosen.faces,
        face_part=chosen.face_part,
        parts=template.parts,
        curve=template.curve[chosen.index],
        curves=template.curves,
        loops={name: place[loop][place[loop] >= 0] for name, loop in template.loops.items()},
        levels=tuple(
            TemplateLevel(place[coarser.index], coarser.faces, coarser.face_part)
            for coarser in template.levels[:level]
        ),
    )
