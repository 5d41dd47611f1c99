"""The command line; nothing else in the package prints."""

import os

from cyclopts import App

from ostiform import __version__

__all__ = ["app", "main"]

HELP = """Statistical shape models of surfaces with openings: no landmarks, no patches, no folds.

Start with `ostiform demo`, or with your own surfaces: write a study.toml, look at it with
`ostiform check study.toml`, then `ostiform build study.toml -o out`.

Exit codes: 0 done, 1 other failure, 2 input, 3 topology, 4 embedding, 5 convergence, 6 artifacts,
130 interrupted.
"""

app = App(
    name="ostiform",
    help=HELP,
    version=__version__,
    help_format="markdown",
    suppress_keyboard_interrupt=False,
)

# By name, so that `ostiform --help` and `--version` do not wait for the numerical libraries.
COMMANDS = {
    "demo": ("demo", "Build the model of a generated population of beating left hearts."),
    "init": ("init", "Propose a study.toml for a folder of meshes or label maps."),
    "check": ("check", "Read every shape of a study and say whether it can be used."),
    "build": ("build", "Build the shape model of a study, with its evidence and report."),
    "embed": ("build", "Only read the shapes and map each to the base domain."),
    "correspond": ("build", "Only up to the correspondence of the shapes."),
    "model": ("build", "Only up to the shape models and their meshes."),
    "evaluate": ("build", "Only up to the evidence that the models are good."),
    "report": ("build", "Everything again that is not current, and the report."),
}
for _name, (_module, _help) in COMMANDS.items():
    app.command(f"ostiform.cli.{_module}:{_name}", name=_name, help=_help)


def main() -> None:
    """Run the command line; ends the process with the command's exit code.

    Linear algebra gets one thread unless the environment says otherwise: work is shared out over
    shapes by processes, and threads that wait for each other on matrices this small only cost.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before a command imports NumPy
    app()
