"""The base domain: spheres, circles, seams, their layout, and the template (HY 2.1, 2.2)."""

from ostiform.domain.checks import check_domain
from ostiform.domain.circle_settings import CircleSetting
from ostiform.domain.delaunay import SizingFunction, spherical_delaunay
from ostiform.domain.json_form import domain_from_json, domain_to_json
from ostiform.domain.layout import lay_out, radius_candidates
from ostiform.domain.levels import with_levels
from ostiform.domain.outline import ComponentOutline, chosen_pole, outlined, pole_circle
from ostiform.domain.pose import (
    PopulationPoses,
    PoseFeatures,
    PoseMethod,
    landmarks,
    population_poses,
    pose_features,
    poses_of_features,
)
from ostiform.domain.template import (
    TriangleQuality,
    assembled_template,
    curve_names,
    graded_template,
    triangle_quality,
)
from ostiform.domain.touching_spheres import (
    circle_from_part_sphere,
    circle_to_part_sphere,
    from_part_sphere,
    stereographic_view,
    to_part_sphere,
    touching_positions,
)
from ostiform.domain.types import (
    NORTH,
    BaseDomain,
    Circle,
    ConformalHoles,
    Sphere,
    Template,
    TemplateLevel,
    tangent_frame,
)

__all__ = [
    "NORTH",
    "BaseDomain",
    "Circle",
    "CircleSetting",
    "ComponentOutline",
    "ConformalHoles",
    "PopulationPoses",
    "PoseFeatures",
    "PoseMethod",
    "SizingFunction",
    "Sphere",
    "Template",
    "TemplateLevel",
    "TriangleQuality",
    "assembled_template",
    "check_domain",
    "chosen_pole",
    "circle_from_part_sphere",
    "circle_to_part_sphere",
    "curve_names",
    "domain_from_json",
    "domain_to_json",
    "from_part_sphere",
    "graded_template",
    "landmarks",
    "lay_out",
    "outlined",
    "pole_circle",
    "population_poses",
    "pose_features",
    "poses_of_features",
    "radius_candidates",
    "spherical_delaunay",
    "stereographic_view",
    "tangent_frame",
    "to_part_sphere",
    "touching_positions",
    "triangle_quality",
    "with_levels",
]
