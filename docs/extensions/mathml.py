"""Mathematics as MathML, which browsers draw themselves: no script, no network, no TeX."""

import re
from html import escape

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.util import logging

TAG = re.compile(r"\\tag\{(.*?)\}")
LOGGER = logging.getLogger(__name__)


def visit_inline(self, node):
    """Write an inline formula."""
    self.body.append(converted(node, "inline"))
    raise nodes.SkipNode


def visit_block(self, node):
    """Write a displayed formula in its own line."""
    tag = TAG.search(node.astext())
    number = f'<span class="eqno">({escape(tag[1])})</span>' if tag else ""
    self.body.append(f'<div class="math">{converted(node, "block")}{number}</div>')
    raise nodes.SkipNode


def converted(node, display):
    """Return a formula as MathML with its TeX for whoever copies it; a fault is a warning."""
    text = TAG.sub("", node.astext()).strip()
    try:
        formula = convert(text, display=display)
    except Exception as error:  # whatever the converter raises is a fault of the formula
        LOGGER.warning("formula %r: %r", text, error, location=node)
        return f"<code>{escape(text)}</code>"
    return formula.replace("<math ", f'<math alttext="{escape(text)}" ', 1)


def setup(app):
    """Register the renderer under the name ``mathml``."""
    app.add_html_math_renderer(
        "mathml", inline_renderers=(visit_inline, None), block_renderers=(visit_block, None)
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
