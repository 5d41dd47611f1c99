"""Stage 4: principal component analysis of the three correspondences, and meshes for other tools.

Artifacts: ``KIND/model.h5``, ``model.h5`` (the optimal one's), and VTP surfaces in ``meshes/``:
the mean, the first modes at -3, -2, 2 and 3 standard deviations, every shape in correspondence.
"""

from collections.abc import Callable
from functools import partial
from pathlib import Path

from ostiform.correspondence import KINDS, Correspondence
from ostiform.model import (
    ShapeModel,
    StoredModel,
    fit_model,
    mesh_of_template,
    project,
    read_correspondence,
    write_corresponded_shape,
    write_mean,
    write_mode,
    write_model,
)
from ostiform.pipeline.correspond import Corresponded, copy_artifact
from ostiform.pipeline.events import Progress
from ostiform.pipeline.run import Run
from ostiform.pipeline.store import key_of, slug

MODES_AS_MESHES = 5
DEVIATIONS = (-3.0, -2.0, 2.0, 3.0)


def model_shapes(run: Run, corresponded: Corresponded) -> None:
    """Fit the three models and write them with their meshes."""
    key = key_of("model", corresponded.key)
    run.on_event(Progress("model", 0, len(KINDS) + 1))
    for done, kind in enumerate(KINDS, start=1):
        if not run.store.is_current(f"{kind}/model.h5", key):
            correspondence = read_correspondence(run.store.path(f"{kind}/correspondence.h5"))
            model = _fitted(correspondence)
            with run.store.writing(f"{kind}/model.h5", key) as path:
                write_model(
                    path,
                    StoredModel(
                        model,
                        project(model, correspondence.aligned),
                        correspondence.ids,
                        correspondence.template,
                    ),
                )
        run.on_event(Progress("model", done, len(KINDS) + 1))
    copy_artifact(run.store, "optimal/model.h5", "model.h5", key)
    correspondence = read_correspondence(run.store.path("optimal/correspondence.h5"))
    _write_meshes(run, correspondence, key)
    run.on_event(Progress("model", len(KINDS) + 1, len(KINDS) + 1))


def _fitted(correspondence: Correspondence) -> ShapeModel:
    mesh = mesh_of_template(correspondence.template)
    return fit_model(correspondence.aligned, correspondence.weights, mesh)


def _write_meshes(run: Run, correspondence: Correspondence, key: str) -> None:
    model = _fitted(correspondence)
    writers: dict[str, Callable[[Path], None]] = {
        "mean": lambda path: write_mean(path, model),
        **{
            f"mode{mode + 1}_{deviation:+.0f}sd": partial(
                write_mode, model=model, mode=mode, deviation=deviation
            )
            for mode in range(min(MODES_AS_MESHES, len(model.modes)))
            for deviation in DEVIATIONS
        },
        **{
            f"shapes/{slug(shape)}": partial(
                write_corresponded_shape, correspondence=correspondence, index=index
            )
            for index, shape in enumerate(correspondence.ids)
        },
    }
    for name, write in writers.items():
        artifact = f"meshes/{name}.vtp"
        if not run.store.is_current(artifact, key):
            with run.store.writing(artifact, key) as path:
                write(path)
