"""The command line; nothing else in the package prints."""

import os
import sys
from typing import NoReturn

from cyclopts import App, CycloptsError, Group, MissingArgumentError

from ostiform import __version__
from ostiform.cli.supervisor import INTERRUPTED, RESUME, supervised

__all__ = ["application", "main"]

HELP = """Statistical shape models of surfaces with openings: no landmarks, no patches,
no folds.

New here? `ostiform demo` generates beating hearts, builds their model and
writes a report.

With surfaces or label maps of your own:

1. `ostiform init FOLDER` proposes a study.toml: which file is which shape, part
   and opening.
2. `ostiform check study.toml` reads everything and says what can be used, and
   why not the rest.
3. `ostiform build study.toml -o out` builds the model; then open
   out/report.html in a browser.

`ostiform COMMAND --help` explains a command and its options.
"""

EPILOGUE = """Exit codes: 0 done, 1 other failure, 2 input or options, 3 topology,
4 embedding, 5 convergence, 6 artifacts, 130 interrupted.
"""

# By name, so that `ostiform --help` and `--version` do not wait for the numerical libraries.
COMMANDS = {
    "demo": ("demo", "Build the model of a generated population of beating left hearts."),
    "init": ("init", "Propose a study.toml for a folder of meshes or label maps."),
    "check": ("check", "Read every shape of a study and say whether it can be used."),
    "build": ("build", "Build the shape model of a study, with its evidence and report."),
    "embed": ("build", "Read the shapes and map each to the sphere, certified free of folds."),
    "correspond": ("build", "Go on to points that correspond between all shapes."),
    "model": ("build", "Go on to the mean and the modes of variation, and their meshes."),
    "evaluate": ("build", "Go on to the evidence: left-out subjects, compactness, specificity."),
    "report": ("build", "The report again, from the results alone."),
    "export": ("export", "Write results in the formats of other programs."),
    "adopt": ("adopt", "Make a model of meshes or particles that correspond already."),
    "add": ("add", "Add shapes to a finished model without moving the others."),
    "widen": ("widen", "Widen a model built from few shapes by a smooth Gaussian process."),
    "fit": ("fit", "Fit a model to surfaces, points, contours or landmarks it has never seen."),
    "predict": ("predict", "Predict the whole cycle of a heart from some of its phases."),
    "synthesize": ("synthesize", "Make shapes and animations from a model file."),
    "compare": ("statistics", "Test whether and where the shapes of groups differ."),
    "regress": ("statistics", "Test whether and where shape depends on age, say."),
}

GROUPS = {
    "Start here": ("demo", "init", "check", "build"),
    "One stage at a time (each runs those before it where they are not current)": (
        "embed",
        "correspond",
        "model",
        "evaluate",
        "report",
    ),
    "Use a model": ("fit", "predict", "synthesize", "compare", "regress"),
    "Change and exchange models": ("add", "widen", "adopt", "export"),
}
OTHERS = "More commands"


def application(command: str = "") -> App:
    """Return the commands, ready to be called.

    Parameters
    ----------
    command : str
        The one that will run, whose module may be imported for its help; of the others only the
        line in `COMMANDS` is known.
    """
    app = App(
        name="ostiform",
        help=HELP,
        help_epilogue=EPILOGUE,
        version=__version__,
        help_format="markdown" if command in COMMANDS else "plaintext",  # imports less
        suppress_keyboard_interrupt=False,
        group_commands=Group("Options", sort_key=len(GROUPS) + 1),
    )
    groups = {title: Group(title, sort_key=rank) for rank, title in enumerate([*GROUPS, OTHERS])}
    group_of = {name: title for title, names in GROUPS.items() for name in names}
    order = [*group_of, *(name for name in COMMANDS if name not in group_of)]
    for name, (module, text) in COMMANDS.items():
        app.command(
            f"ostiform.cli.{module}:{name}",
            name=name,
            help=None if name == command else text,
            group=groups[group_of.get(name, OTHERS)],
            sort_key=order.index(name),
        )
    app.register_install_completion_command(
        help="Teach your shell to complete commands and options (bash, zsh, fish, PowerShell)."
    )
    return app


def main() -> None:
    """Run the command line; ends the process with the command's exit code.

    Linear algebra gets one thread unless the environment says otherwise: work is shared out over
    shapes by processes, and threads that wait for each other on matrices this small only cost.
    """
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # before a command imports NumPy
    supervised(_run)


def _run() -> None:
    words = sys.argv[1:]
    app = application(words[0] if words else "")
    try:
        app(words, exit_on_error=False, print_error=False)
    except CycloptsError as error:
        print(_sentence(error), file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print(RESUME, file=sys.stderr)
        _leave_at_once()
    except SystemExit as end:
        if end.code == INTERRUPTED:
            _leave_at_once()
        raise
    except BrokenPipeError:  # whoever read the output has left
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)


def _leave_at_once() -> NoReturn:
    """End the process without taking the libraries down in order, which lasts seconds.

    Files are written whole or not at all, so nothing is lost.
    """
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(INTERRUPTED)


def _sentence(error: CycloptsError) -> str:
    command = " ".join(("ostiform", *(error.command_chain or ())))
    if isinstance(error, MissingArgumentError) and error.argument is not None:
        name = error.argument.names[0]
        return (
            f"error: {command}: expected a value for {name}, found none "
            f"(`{command} --help` lists what there is)"
        )
    return f"error: {' '.join(str(error).split())} (`{command} --help` lists what there is)"
