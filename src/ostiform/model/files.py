"""Correspondences as HDF5, and models and corresponded shapes as VTP (design 7).

The layout of ``correspondence.h5`` is a promise to other programs.
"""

from collections.abc import Sequence
from pathlib import Path

from ostiform.correspondence import Correspondence
from ostiform.model.hdf5 import (
    check_schema,
    put_facts,
    put_ids,
    put_shapes,
    put_template,
    reading,
    take_shapes,
    take_template,
    writing,
)
from ostiform.model.surface_fields import SurfaceField, field_summary
from ostiform.model.types import ShapeModel
from ostiform.surface import write_surface


def write_correspondence(path: Path, correspondence: Correspondence) -> None:
    """Write a correspondence in the layout of design section 7.

    Datasets: `points`, `aligned`, `transforms`, `faces`, `face_part`, `part`, `weights`,
    `subject`, `phase`, `time`, ``loops/<part>/<ostium>``, ``levels/<n>/{index, faces,
    face_part}``; further `directions` (N, P, 3), `template_points` (P, 3), `sphere` (P,) and
    `curve` (P,) (index into the attribute `curves`, -1 in the interior), which hold the template
    and where its points went on each shape's sphere. Attributes: `schema`, `units`, `frame`,
    `package_version`, `parts`, `curves`. Indices start at 0.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    InputError
        If an opening's name cannot be the name of a dataset.
    """
    with writing(path) as file:
        put_facts(file, correspondence.template.parts)
        put_shapes(file, correspondence)
        file.create_dataset("directions", data=correspondence.directions)
        put_template(file, correspondence.template)
        put_ids(file, correspondence.ids)


def read_correspondence(path: Path) -> Correspondence:
    """Read what `write_correspondence` wrote.

    Raises
    ------
    ArtifactError
        If the file is missing, damaged or of another kind or schema.
    """
    with reading(path, "a correspondence of ostiform") as file:
        check_schema(file)
        return Correspondence(
            **take_shapes(file),
            template=take_template(file),
            directions=file["directions"][:],
        )


def write_mean(path: Path, model: ShapeModel, fields: Sequence[SurfaceField] = ()) -> None:
    """Write the mean shape as VTP: parts as cell data; area shares and fields as point data."""
    summaries = {n: v for f in fields for n, v in field_summary(f).arrays(f).items()}
    write_surface(
        path,
        model.mean,
        model.mesh.faces,
        point_data={**summaries, "area_share": model.weights},
        cell_data={"part": model.mesh.face_part},
    )


def write_mode(path: Path, model: ShapeModel, mode: int, deviation: float) -> None:
    """Write the mean displaced along one mode as VTP, the displacement as point data.

    Parameters
    ----------
    path : Path
    model : ShapeModel
    mode : int
        Index from 0.
    deviation : float
        In standard deviations (HY Fig. 3 shows -2 and +2).

    Raises
    ------
    InputError
        If the model has no such mode.
    """
    shape = model.displaced(mode, deviation)
    write_surface(
        path,
        shape,
        model.mesh.faces,
        point_data={"displacement_mm": shape - model.mean},
        cell_data={"part": model.mesh.face_part},
    )


def write_corresponded_shape(
    path: Path, correspondence: Correspondence, index: int, fields: Sequence[SurfaceField] = ()
) -> None:
    """Write one shape resampled in correspondence as VTP, in its input coordinates."""
    template = correspondence.template
    write_surface(
        path,
        correspondence.points[index],
        template.faces,
        point_data={
            **{field.name: field.values[index] for field in fields},
            "area_share": correspondence.weights,
        },
        cell_data={"part": template.face_part},
    )
