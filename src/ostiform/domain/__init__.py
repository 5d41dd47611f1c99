"""The base domain: spheres, circles, seams, their layout, and the template (HY 2.1, 2.2)."""

from ostiform.domain.types import (
    BaseDomain,
    Circle,
    ConformalHoles,
    Sphere,
    Template,
    TemplateLevel,
    tangent_frame,
)

__all__ = [
    "BaseDomain",
    "Circle",
    "ConformalHoles",
    "Sphere",
    "Template",
    "TemplateLevel",
    "tangent_frame",
]
