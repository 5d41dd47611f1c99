"""Dynamic models as files: the model of all phases, and the trajectories fitted to them."""

from pathlib import Path

import numpy as np

from ostiform.domain import Template
from ostiform.model.dynamics import DynamicModel, dynamic_model
from ostiform.model.hdf5 import put_texts, reading, take_texts, writing
from ostiform.model.statismo import OWN_GROUP, put_model, take_model
from ostiform.model.trajectories import Trajectories
from ostiform.model.types import StoredModel

GROUP = "trajectories"
ARRAYS = ("coefficients", "common", "choices", "left_out_errors")


def write_dynamic_model(path: Path, model: DynamicModel, template: Template | None) -> None:
    """Write a dynamic model: a model file of all phases (`write_model`) with the trajectories.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    with writing(path) as file:
        put_model(file, StoredModel(model.total, model.scores, model.ids, template))
        group = file.create_group(GROUP)
        put_texts(group, "subjects", model.trajectories.subjects)
        for name in ARRAYS:
            group.create_dataset(name, data=getattr(model.trajectories, name))


def read_dynamic_model(path: Path) -> DynamicModel:
    """Read what `write_dynamic_model` wrote; nothing is fitted.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind.
    """
    with reading(path, "a dynamic model of ostiform") as file:
        stored = take_model(file[OWN_GROUP])
        group = file[GROUP]
        trajectories = Trajectories(
            take_texts(group["subjects"]), *(np.asarray(group[name]) for name in ARRAYS)
        )
        return dynamic_model(stored.model, stored.scores, stored.ids, trajectories)
