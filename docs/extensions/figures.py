"""Pictures of the gallery from Matplotlib figures that pyplot does not know."""

from matplotlib import pyplot
from matplotlib.figure import Figure
from sphinx_gallery.scrapers import figure_rst


class FigureScraper:
    """Save every figure that a block of an example has made and bound to a name, once.

    It must come before the scraper of pyplot's figures, which closes them: those it knows by their
    being open.
    """

    def __repr__(self):
        """Return the same text in every run, so that Sphinx sees no change of the settings."""
        return "FigureScraper"

    def __call__(self, block, block_vars, gallery_conf):
        """Return the reStructuredText of the new figures."""
        known = block_vars["example_globals"].setdefault("__known_figures__", [])
        known += [pyplot.figure(number) for number in pyplot.get_fignums()]
        names = []
        for value in list(block_vars["example_globals"].values()):
            if not isinstance(value, Figure) or any(value is other for other in known):
                continue
            known.append(value)
            names.append(next(block_vars["image_path_iterator"]))
            value.savefig(names[-1], format="png", dpi=150)
        return figure_rst(names, gallery_conf["src_dir"])
