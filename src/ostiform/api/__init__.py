"""The program as seen from a notebook: read a study, build it, and use the results.

Everything here is also available as ``ostiform.NAME``.
"""

from ostiform.api import figures
from ostiform.api.example import example_results, example_study
from ostiform.api.loading import read_model, read_study
from ostiform.api.results import Results, build, read_results
from ostiform.pipeline import Stage

__all__ = [
    "Results",
    "Stage",
    "build",
    "example_results",
    "example_study",
    "figures",
    "read_model",
    "read_results",
    "read_study",
]
