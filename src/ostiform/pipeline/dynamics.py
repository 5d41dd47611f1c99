"""Who and when: the dynamic model of a run and its evaluation.

Artifacts: ``dynamics.h5`` (the model of all phases with its trajectories) and ``dynamics.json``
(its evaluation); neither where no subject has several phases.
"""

from dataclasses import replace

from ostiform.errors import ArtifactError
from ostiform.evaluation import (
    DynamicEvaluation,
    dynamic_evaluation_facts,
    dynamic_evaluation_from_facts,
    evaluate_dynamic_model,
)
from ostiform.model import (
    StoredModel,
    dynamic_model_of,
    read_dynamic_model,
    with_landmarks_aligned,
    write_dynamic_model,
)
from ostiform.pipeline.store import Store, key_of
from ostiform.study import StudySettings

MODEL, EVALUATION = "dynamics.h5", "dynamics.json"


def write_dynamics(
    store: Store, correspondence_key: str, stored: StoredModel, settings: StudySettings
) -> None:
    """Fit and evaluate the dynamic model, unless that is done.

    Parameters
    ----------
    store : Store
    correspondence_key : str
    stored : StoredModel
        The optimal model.
    settings : StudySettings
        Landmarks in time, seed and number of random shapes are looked at.
    """
    subjects = list(dict.fromkeys(id.subject for id in stored.ids))
    if len(subjects) == len(stored.ids):
        for name in (MODEL, EVALUATION):
            store.remove(name)
        return
    landmarks, samples = settings.cycle.landmarks, settings.evaluation.specificity_samples
    key = key_of("dynamics", correspondence_key, landmarks, settings.seed, samples)
    if store.is_current(MODEL, key) and store.is_current(EVALUATION, key):
        return
    ids = stored.ids
    if landmarks:
        ids = with_landmarks_aligned(ids, {subject: landmarks[subject] for subject in subjects})
    model = dynamic_model_of(replace(stored, ids=ids))
    evaluation = evaluate_dynamic_model(model, settings.seed, samples)
    with store.writing(MODEL, key) as path:
        write_dynamic_model(path, model, stored.template)
    store.write_json(EVALUATION, key, dynamic_evaluation_facts(evaluation))


def read_dynamics(store: Store) -> DynamicEvaluation | None:
    """Return the dynamic model of a run with its evaluation; None where there is none.

    Raises
    ------
    ArtifactError
        If a file is damaged.
    """
    if not store.path(MODEL).is_file():
        return None
    model = read_dynamic_model(store.path(MODEL))
    facts = store.read_json(EVALUATION)
    try:
        return dynamic_evaluation_from_facts(facts, model)
    except (KeyError, TypeError, ValueError) as error:
        raise ArtifactError(
            f"{store.path(EVALUATION)}: expected the evaluation of {MODEL}, found another "
            f"({error!r}); run `ostiform model` on this output folder"
        ) from error
