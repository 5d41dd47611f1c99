"""The exception tree.

    OstiformError
    |-- InputError        a file, a setting or an array that cannot be used as it is
    |   `-- UnlabelledError   an image that nobody segmented
    |-- TopologyError     a surface whose topology the method cannot handle
    |-- EmbeddingError    a surface that could not be mapped to its sphere without folds
    |-- ConvergenceError  an iteration that stopped without reaching its goal
    |-- ArtifactError     a missing, foreign or damaged result of an earlier stage
    |-- CollapseError     a model that is compact because its points left part of the surfaces

Every message is one sentence: which file or subject, what was expected, what was found, what to do.
"""


class OstiformError(Exception):
    """Any failure that Ostiform foresees and explains."""


class InputError(OstiformError, ValueError):
    """A file, a setting or an array that cannot be used as it is."""


class UnlabelledError(InputError):
    """An image, or a frame of one, without any label: nobody segmented it."""


class TopologyError(OstiformError, ValueError):
    """A surface whose topology the method cannot handle (genus, loops, orientation)."""


class EmbeddingError(OstiformError):
    """A surface that could not be mapped to its sphere without folds."""


class ConvergenceError(OstiformError):
    """An iteration that stopped without reaching its goal."""


class ArtifactError(OstiformError):
    """A missing, foreign or damaged result of an earlier stage."""


class CollapseError(OstiformError):
    """A model that is compact because its points left part of the surfaces."""
