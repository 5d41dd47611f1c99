"""Files that other programs write and read: models, meshes, particles, landmarks, animations."""

from ostiform.exchange.dressing import dressed, medoid_shape
from ostiform.exchange.gltf import (
    MorphTarget,
    SceneMesh,
    WeightAnimation,
    glb_bytes,
    write_glb,
)
from ostiform.exchange.landmarks import Landmark, read_landmarks, write_landmarks
from ostiform.exchange.modes_gltf import (
    CycleFrames,
    mean_cycle_frames,
    write_cycle_glb,
    write_modes_glb,
)
from ostiform.exchange.particles import (
    PARTICLE_SUFFIXES,
    ProjectRow,
    read_particles,
    read_project,
    write_particles,
    write_swproj,
    write_xlsx_project,
)
from ostiform.exchange.shapes_vtp import write_shape_vtp
from ostiform.exchange.tables import (
    write_scores_csv,
    write_shape_values_csv,
    write_table,
    write_volumes_csv,
)
from ostiform.exchange.vertex_order import (
    OrderedShapes,
    SourceFile,
    found_ids,
    mesh_with_openings,
    read_landmark_shapes,
    read_ordered_meshes,
    read_particle_shapes,
)

__all__ = [
    "CycleFrames",
    "Landmark",
    "MorphTarget",
    "OrderedShapes",
    "PARTICLE_SUFFIXES",
    "ProjectRow",
    "SceneMesh",
    "SourceFile",
    "WeightAnimation",
    "dressed",
    "found_ids",
    "glb_bytes",
    "mean_cycle_frames",
    "medoid_shape",
    "mesh_with_openings",
    "read_landmark_shapes",
    "read_landmarks",
    "read_ordered_meshes",
    "read_particle_shapes",
    "read_particles",
    "read_project",
    "write_cycle_glb",
    "write_glb",
    "write_landmarks",
    "write_modes_glb",
    "write_particles",
    "write_scores_csv",
    "write_shape_values_csv",
    "write_table",
    "write_shape_vtp",
    "write_swproj",
    "write_volumes_csv",
    "write_xlsx_project",
]
