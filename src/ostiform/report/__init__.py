"""Figures and the report; nothing else in the library plots."""

from ostiform.report.evidence import (
    correspondence_section,
    evidence_section,
    headline,
    modes_section,
    scores_section,
    template_section,
)
from ostiform.report.html import Fact, Page, Picture, Section, Table, render_page, save_picture
from ostiform.report.mapping import ShapeMaps, StateView, maps_section, run_section

__all__ = [
    "Fact",
    "Page",
    "Picture",
    "Section",
    "ShapeMaps",
    "StateView",
    "Table",
    "correspondence_section",
    "evidence_section",
    "headline",
    "maps_section",
    "modes_section",
    "render_page",
    "run_section",
    "save_picture",
    "scores_section",
    "template_section",
]
