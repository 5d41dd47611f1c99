"""Figures and the report; nothing else in the library plots."""

from ostiform.report.evidence import evidence_section, headline
from ostiform.report.html import (
    Drawing,
    Fact,
    Page,
    Picture,
    Section,
    Table,
    draw_picture,
    render_page,
    save_drawing,
)
from ostiform.report.mapping import ShapeMaps, StateView, maps_section, run_section
from ostiform.report.population import (
    correspondence_section,
    modes_section,
    scores_section,
    template_section,
)
from ostiform.report.viewer import viewer_data, viewer_section
from ostiform.report.volumes import volumes_section

__all__ = [
    "Drawing",
    "Fact",
    "Page",
    "Picture",
    "Section",
    "ShapeMaps",
    "StateView",
    "Table",
    "correspondence_section",
    "draw_picture",
    "evidence_section",
    "headline",
    "maps_section",
    "modes_section",
    "render_page",
    "run_section",
    "save_drawing",
    "scores_section",
    "template_section",
    "viewer_data",
    "viewer_section",
    "volumes_section",
]
