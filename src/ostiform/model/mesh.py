"""The triangulation that a model's points share, with the names of its parts and openings."""

from collections.abc import Mapping
from typing import Annotated

import numpy as np

from ostiform.arrays import IntArray
from ostiform.domain import Template
from ostiform.errors import InputError
from ostiform.values import Axes, IndexOf, value


@value
class ModelMesh:
    """The triangulation that a model's points share, with the names of its parts and openings.

    Attributes
    ----------
    faces : (F, 3) int64
        Point indices, counter-clockwise seen from outside.
    face_part : (F,) int64
        Index into `parts`.
    part : (P,) int64
        Index into `parts`; a seam point carries the first part of its seam.
    parts : tuple of str
    loops : mapping of str to (n,) int64
        Points of each ostium's rim by full name, surface of that part on the left.
    """

    faces: Annotated[IntArray, Axes("F", 3), IndexOf("P")]
    face_part: Annotated[IntArray, Axes("F"), IndexOf("parts")]
    part: Annotated[IntArray, Axes("P"), IndexOf("parts")]
    parts: Annotated[tuple[str, ...], Axes("parts")]
    loops: Mapping[str, Annotated[IntArray, Axes(None), IndexOf("P")]]

    def restricted(self, points: IntArray) -> "ModelMesh":
        """Return what is left on some of the points (Q,), in the order given.

        Triangles and openings are kept where all their points are.
        """
        place = self._places(points)
        inside = (place[self.faces] >= 0).all(axis=1)  # (F,)
        return ModelMesh(
            faces=place[self.faces[inside]],
            face_part=self.face_part[inside],
            part=self.part[points],
            parts=self.parts,
            loops={
                name: place[loop] for name, loop in self.loops.items() if (place[loop] >= 0).all()
            },
        )

    def of_part(self, name: str) -> tuple[IntArray, "ModelMesh"]:
        """Return the points (Q,) of one part, those of its seams included, and its mesh.

        Raises
        ------
        InputError
            If there is no such part.
        """
        if name not in self.parts:
            raise InputError(
                f"part of a model: expected one of {', '.join(self.parts)}, found {name}"
            )
        inside = self.face_part == self.parts.index(name)
        points: IntArray = np.unique(self.faces[inside])
        place = self._places(points)
        mesh = ModelMesh(
            faces=place[self.faces[inside]],
            face_part=np.zeros(int(inside.sum()), dtype=np.int64),
            part=np.zeros(len(points), dtype=np.int64),
            parts=(name,),
            loops={
                key: place[loop] for key, loop in self.loops.items() if key.startswith(f"{name}.")
            },
        )
        return points, mesh

    def _places(self, points: IntArray) -> IntArray:
        """Return where each point (P,) stands among some of them; -1 where it is not."""
        place = np.full(len(self.part), -1, dtype=np.int64)
        place[points] = np.arange(len(points))
        return place


def mesh_of_template(template: Template) -> ModelMesh:
    """Return what a model keeps of a template: its triangles, parts and openings."""
    return ModelMesh(
        faces=template.faces,
        face_part=template.face_part,
        part=template.part,
        parts=template.parts,
        loops=template.loops,
    )
