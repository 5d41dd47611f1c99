"""Who and when: the dynamic model of a run and what is measured on its shapes.

Artifacts: ``dynamics.h5`` (the model of all phases with their scores and times, from which
`ostiform.model.dynamic_model_of` makes the dynamic model), ``dynamics.json`` (its evaluation) and
``clinical.csv`` (volumes, openings, long axis, twist of every shape).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from ostiform.correspondence import Correspondence
from ostiform.evaluation import (
    ClinicalTable,
    DynamicEvaluation,
    clinical_table,
    dynamic_evaluation_facts,
    evaluate_dynamic_model,
)
from ostiform.exchange import write_shape_values_csv
from ostiform.model import StoredModel, dynamic_model_of, with_landmarks_aligned, write_model
from ostiform.pipeline.store import Store, key_of


@dataclass(frozen=True, slots=True, eq=False)
class Dynamics:
    """What is known of the motion of a run's shapes.

    Attributes
    ----------
    evaluation : DynamicEvaluation or None
        None where no subject has several phases.
    clinical : ClinicalTable
    """

    evaluation: DynamicEvaluation | None
    clinical: ClinicalTable


def write_dynamics(
    store: Store,
    correspondence_key: str,
    stored: StoredModel,
    correspondence: Correspondence,
    settings: Mapping[str, Any],
) -> Dynamics:
    """Fit and evaluate the dynamic model, measure all shapes, and write the artifacts.

    Parameters
    ----------
    store : Store
    correspondence_key : str
    stored : StoredModel
        The optimal model.
    correspondence : Correspondence
        Its shapes.
    settings : mapping
        Of the study, as plain values; `cycle`, `seed` and `evaluation` are looked at.
    """
    landmarks = settings.get("cycle", {}).get("landmarks", {})
    samples = settings["evaluation"]["specificity_samples"]
    key = key_of("dynamics", correspondence_key, landmarks, settings["seed"], samples)
    clinical = clinical_table(
        correspondence.ids, correspondence.points, correspondence.aligned, stored.model.mesh
    )
    with store.writing("clinical.csv", key) as path:
        write_shape_values_csv(path, clinical.ids, clinical.columns, clinical.values)
    subjects = list(dict.fromkeys(id.subject for id in stored.ids))
    if len(subjects) == len(stored.ids):
        return Dynamics(None, clinical)
    ids = stored.ids
    if landmarks:
        ids = with_landmarks_aligned(ids, {subject: landmarks[subject] for subject in subjects})
    model = dynamic_model_of(replace(stored, ids=ids))
    evaluation = evaluate_dynamic_model(model, settings["seed"], samples)
    if not store.is_current("dynamics.h5", key):
        with store.writing("dynamics.h5", key) as path:
            write_model(path, StoredModel(model.total, model.scores, ids, stored.template))
    store.write_json("dynamics.json", key, dynamic_evaluation_facts(evaluation))
    return Dynamics(evaluation, clinical)
