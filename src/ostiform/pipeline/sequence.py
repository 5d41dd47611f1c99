"""A beating model fitted to all phases of a shape, from files to files.

Artifacts in the output folder: ``phases/NAME.vtp`` (every given phase), ``cycle/NNNN.vtp`` (even
times of the cycle), ``curves.csv`` (volumes, openings, axes over the cycle with 95 % intervals),
``shifts.csv``, ``cycle.glb``, ``cycle.webp`` and ``fit.json``. All meshes share their vertex order.
"""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ostiform import __version__
from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.evaluation import clinical_measures, long_axes
from ostiform.exchange import CycleFrames, write_cycle_glb
from ostiform.fitting import SequenceFit, SequencePrior, cycle_at, cycle_deviations_at, drawn_cycles
from ostiform.model import ENOUGH_SUBJECTS, StoredModel, reconstruct
from ostiform.report import cycle_animation, write_webp
from ostiform.surface import write_surface
from ostiform.tables import write_table
from ostiform.values import Axes, value

WIDTH = 1.96
"""Standard deviations of a 95 % interval."""


@value
class SequenceCurves:
    """Numbers of a fitted cycle over time, with their uncertainty.

    Attributes
    ----------
    times : (n,) float64
        Fractions of the cycle.
    names : tuple of str
        Of the C quantities, each with its unit at the end (`clinical_measures`).
    means, deviations : (C, n) float64
        Of the fitted cycle, and standard deviations over cycles drawn from the posterior.
    """

    times: Annotated[FloatArray, Axes("n")]
    names: Annotated[tuple[str, ...], Axes("C")]
    means: Annotated[FloatArray, Axes("C", "n")]
    deviations: Annotated[FloatArray, Axes("C", "n")]

    def interval(self, name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return mean and both ends of the 95 % interval (n,) of a quantity.

        Raises
        ------
        InputError
            If there is no such quantity.
        """
        if name not in self.names:
            raise InputError(
                f"curves of a cycle: expected one of {', '.join(self.names)}, found {name}"
            )
        index = self.names.index(name)
        half = WIDTH * self.deviations[index]
        return self.means[index], self.means[index] - half, self.means[index] + half


@dataclass(frozen=True, slots=True)
class _Place:
    """Where the meshes of a fit go."""

    folder: Path
    prior: SequencePrior
    fit: SequenceFit

    def write(self, name: str, shape: FloatArray, normal: FloatArray, overall: FloatArray) -> None:
        mesh = self.prior.space.model.mesh
        write_surface(
            self.folder / f"{name}.vtp",
            shape,
            mesh.faces,
            point_data={"normal_sd_mm": normal, "posterior_sd_mm": overall},
            cell_data={"part": mesh.face_part},
        )


def sequence_curves(
    stored: StoredModel, prior: SequencePrior, fit: SequenceFit, times: FloatArray
) -> SequenceCurves:
    """Return volumes, ejection, openings and axes of a fitted cycle at some times (n,).

    Parameters
    ----------
    stored : StoredModel
        Whose training shapes say which opening is the annulus and which point the apex.
    prior : SequencePrior
    fit : SequenceFit
    times : (n,) float64
    """
    mesh = prior.space.model.mesh
    axes = long_axes(reconstruct(stored.model, stored.scores), mesh)
    own = clinical_measures(cycle_at(prior, fit, times), mesh, axes)
    drawn = [clinical_measures(c, mesh, axes) for c in drawn_cycles(prior, fit, times)]
    names = tuple(own)
    spread = np.stack([np.stack([each[name] for name in names]) for each in drawn])  # (D, C, n)
    return SequenceCurves(
        np.asarray(times, dtype=np.float64),
        names,
        np.stack([own[name] for name in names]),
        spread.std(axis=0, ddof=1),
    )


def write_sequence(
    folder: Path,
    stored: StoredModel,
    prior: SequencePrior,
    fit: SequenceFit,
    frames: int,
    notes: tuple[str, ...] = (),
) -> dict[str, Any]:
    """Write a fitted cycle and return what ``fit.json`` holds.

    Parameters
    ----------
    folder : Path
        Made if missing; files of the same names are replaced.
    stored : StoredModel
    prior : SequencePrior
    fit : SequenceFit
    frames : int
        Even times of the cycle at which meshes and curves are written; at least two.
    notes : tuple of str
        Further sentences for ``fit.json``.

    Raises
    ------
    InputError
        If there are fewer than two frames.
    ArtifactError
        If a file cannot be written.
    """
    if frames < 2:
        raise InputError(f"frames of a cycle: expected at least 2, found {frames}")
    model = prior.space.model
    times = np.arange(frames) / frames
    shapes = cycle_at(prior, fit, times)
    normal, overall = cycle_deviations_at(prior, fit, times)
    place = _Place(folder, prior, fit)
    for index, name in enumerate(fit.names):
        place.write(f"phases/{name}", fit.points[index], fit.normal_sd[index], fit.point_sd[index])
    for index in range(frames):
        place.write(f"cycle/{index:04d}", shapes[index], normal[index], overall[index])
    curves = sequence_curves(stored, prior, fit, times)
    _write_curves(folder / "curves.csv", curves)
    _write_shifts(folder / "shifts.csv", fit)
    write_cycle_glb(folder / "cycle.glb", model.mesh, CycleFrames(times, shapes))
    write_webp(folder / "cycle.webp", cycle_animation(model, shapes, times, "fitted"))
    facts = _facts(prior, fit, curves, notes)
    with atomically(folder / "fit.json") as temporary:
        temporary.write_text(json.dumps(facts, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return facts


def _write_curves(path: Path, curves: SequenceCurves) -> None:
    header = ["time"]
    columns = [curves.times]
    for name in curves.names:
        header += [name, f"{name}_low", f"{name}_high"]
        columns += curves.interval(name)
    write_table(path, header, ([float(v) for v in row] for row in np.stack(columns, axis=1)))


def _write_shifts(path: Path, fit: SequenceFit) -> None:
    header = ["slice", "x_mm", "y_mm", "z_mm", "through_mm", "sd_mm", "residue_mm"]
    rows = ([s.slice, *map(float, s.shift), s.through, s.sd, s.residue] for s in fit.shifts)
    write_table(path, header, rows)


def _facts(
    prior: SequencePrior, fit: SequenceFit, curves: SequenceCurves, notes: tuple[str, ...]
) -> dict[str, Any]:
    weak: tuple[str, ...] = ()
    if prior.subjects < ENOUGH_SUBJECTS:
        weak = (
            f"the prior is weak: expected at least {ENOUGH_SUBJECTS} training subjects, found "
            f"{prior.subjects}; where there are no data the fit is hardly more than the mean "
            "motion",
        )
    return {
        "schema": 1,
        "package_version": __version__,
        "status": fit.status.value,
        "iterations": fit.iterations,
        "phases": {
            name: {"time": float(time), "data_to_model_mm": asdict(fit.residues[name])}
            for name, time in zip(fit.names, fit.times, strict=True)
        },
        "pose": {
            "matrix": fit.pose.matrix.tolist(),
            "sd": {"rotation_deg": fit.pose_sd[0], "translation_mm": fit.pose_sd[1]},
        },
        "scores_mm": fit.scores.tolist(),
        "noise_mm": dict(fit.noise_mm),
        "outlier_share": fit.outlier_share,
        "point_sd_mm": {
            "mean": float(np.mean(fit.point_sd @ prior.space.model.weights)),
            "max": float(fit.point_sd.max()),
        },
        "shifts_mm": {s.slice: [float(v) for v in s.shift] for s in fit.shifts},
        "ejection": _ejection(curves),
        "typicality": asdict(fit.typicality),
        "training_subjects": prior.subjects,
        "notes": [*notes, *weak, *fit.notes],
    }


def _ejection(curves: SequenceCurves) -> dict[str, dict[str, float | list[float]]]:
    """Return ejection fraction, largest and smallest volume of every part that ejects."""
    found: dict[str, dict[str, float | list[float]]] = {}
    ending = "_ejection_fraction_percent"
    for name in curves.names:
        if not name.endswith(ending):
            continue
        part = name.removesuffix(ending)
        mean, low, high = curves.interval(name)
        volumes = curves.interval(f"{part}_volume_ml")[0]
        found[part] = {
            "ejection_fraction_percent": float(mean[0]),
            "interval_percent": [float(low[0]), float(high[0])],
            "largest_volume_ml": float(volumes.max()),
            "smallest_volume_ml": float(volumes.min()),
            "time_of_largest": float(curves.times[volumes.argmax()]),
            "time_of_smallest": float(curves.times[volumes.argmin()]),
        }
    return found
