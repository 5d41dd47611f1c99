"""
The cycle of a heart from one of its phases
===========================================

A model of twenty beating hearts, made for the purpose with known correspondence, predicts the whole
cycle of a heart that it has never seen.
"""

import matplotlib.pyplot as plt
import numpy as np

from ostiform.demo import demonstration_truth
from ostiform.evaluation import part_volumes, prediction_errors, true_population
from ostiform.model import ObservedPhase, fit_cycle_predictor, fit_dynamic_model, predict_cycle

subjects, phases = 21, 10
hearts = true_population(demonstration_truth(subjects, subjects * phases, seed=5), edge_mm=7.0)
train, unseen = slice(0, 20 * phases), slice(20 * phases, None)
model = fit_dynamic_model(hearts.aligned[train], hearts.ids[train], hearts.weights, hearts.mesh)
points, times = hearts.points[unseen], [id.time for id in hearts.ids[unseen]]

# %%
# Learn to predict from the end of diastole alone, and from it with the end of systole. The errors
# are mean distances over the phases that were not given, beside those of two baselines.

cycles = {}
instants = np.linspace(0.0, 1.0, 41)
certain = np.zeros((0, *points.shape[1:]))
systole = int(np.abs(np.array(times) - 0.35).argmin())
for name, given in (("end of diastole", [0]), ("and end of systole", [0, systole])):
    predictor = fit_cycle_predictor(model, [times[k] for k in given])
    errors = prediction_errors(predictor, points, times, given)
    print(
        f"{name}: {errors.predicted.mean():.2f} mm; mean motion "
        f"{errors.mean_motion.mean():.2f} mm; "
        f"nearest heart's motion {errors.nearest_subject.mean():.2f} mm"
    )
    seen = [ObservedPhase(times[k], points[k], certain) for k in given]
    cycles[name] = predict_cycle(predictor, seen, instants)

# %%
# The volume of the ventricle, predicted and true, and how sure the prediction is of its points.

figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
left.plot(times, part_volumes(points, hearts.mesh)["LV"] / 1000.0, "ko", label="true phases")
for name, cycle in cycles.items():
    left.plot(instants, part_volumes(cycle.shapes, hearts.mesh)["LV"] / 1000.0, label=name)
    right.plot(instants, np.sqrt(cycle.deviations**2 @ hearts.weights))
left.set_ylabel("LV volume (ml)")
right.set_ylabel("sd of a coordinate (mm)")
for panel in (left, right):
    panel.set_xlabel("time (fraction of the cycle)")
figure.legend(loc="outside upper center", ncols=3)
plt.show()
