"""Figures and the report; nothing else in the library plots."""

from ostiform.report.cycles import clinical_section, cycles_section
from ostiform.report.evidence import evidence_section, headline, headline_table
from ostiform.report.html import (
    Drawing,
    Fact,
    Page,
    Picture,
    Section,
    Table,
    draw_picture,
    remove_stale_drawings,
    render_page,
    save_drawing,
)
from ostiform.report.map_records import MapRecord, SeamKink, map_record, sampled_kinks
from ostiform.report.mapping import StateView, maps_section
from ostiform.report.population import (
    correspondence_section,
    modes_section,
    scores_section,
    template_section,
)
from ostiform.report.provenance import run_section
from ostiform.report.quality import FailedShape, quality_section
from ostiform.report.viewer import viewer_data, viewer_section
from ostiform.report.volumes import volumes_section

__all__ = [
    "Drawing",
    "Fact",
    "FailedShape",
    "MapRecord",
    "Page",
    "Picture",
    "Section",
    "SeamKink",
    "StateView",
    "Table",
    "clinical_section",
    "correspondence_section",
    "cycles_section",
    "draw_picture",
    "evidence_section",
    "headline",
    "headline_table",
    "map_record",
    "maps_section",
    "modes_section",
    "quality_section",
    "remove_stale_drawings",
    "render_page",
    "run_section",
    "sampled_kinks",
    "save_drawing",
    "scores_section",
    "template_section",
    "viewer_data",
    "viewer_section",
    "volumes_section",
]
