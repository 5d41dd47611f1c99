"""
From files to a model
=====================

The whole chain from Python: a study is written, read, changed and built.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import ostiform

# %%
# A study is a ``study.toml`` with files beside it; here the example study is copied. Nothing but
# the study file is read yet.

folder = Path(tempfile.mkdtemp())
study = ostiform.read_study(ostiform.example_results().parent / "study" / "study.toml")
print(study.path.name, "with", len(study.entries), "shapes of", *study.settings.part_names)

# %%
# Settings may be changed in memory instead of in the file: two subjects, fewer points.

settings = study.settings.model_copy(
    update={"template": study.settings.template.model_copy(update={"points": 200})}
)
small = replace(study, settings=settings, entries=study.entries[:10])

# %%
# Building until the models stand; `on_event` gets an event for every step. A second call would find
# everything current and do nothing.

stages = []
results = ostiform.build(
    small,
    folder / "out",
    until=ostiform.Stage.MODEL,
    on_event=lambda event: stages.append(getattr(event, "stage", None)),
)
print("stages:", *dict.fromkeys(filter(None, stages)))
print("left out:", results.left_out or "none")

# %%
# Random shapes of the new model, scores truncated at 3 standard deviations.

model = results.model
figure = ostiform.figures.shapes(model, model.sample(4, seed=1), ("a", "b", "c", "d"))
