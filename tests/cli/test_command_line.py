import json
import os
import pty
import re
import select
import shutil
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from cyclopts import CycloptsError
from rich.progress import Progress as RichProgress

from ostiform import cli
from ostiform.cli.options import Common
from ostiform.cli.running import EXIT_CODES, run_command, show_summary, worker_count
from ostiform.cli.watch import _Pace, watching
from ostiform.errors import ArtifactError, InputError, OstiformError
from ostiform.pipeline.build import Summary
from ostiform.pipeline.events import Note, Progress, Warn
from ostiform.pipeline.run import Failure
from ostiform.study import ShapeId

COMMON = Common(workers=1)


def ostiform(*arguments, **environment):
    """Run the program in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "ostiform", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "COLUMNS": "100", **environment},
        check=False,
    )


def test_help_groups_the_commands_and_states_the_exit_codes(capsys):
    cli.application()(["--help"], result_action="return_value")
    printed = capsys.readouterr().out
    positions = [printed.index(title) for title in ("Start here", "One stage", "Options")]
    assert positions == sorted(positions)
    for name in cli.COMMANDS:
        assert re.search(rf"^│ {name} ", printed, re.MULTILINE), name
    assert "130 interrupted" in printed


HEAVY = ("scipy", "numba", "vtkmodules", "pyvista", "matplotlib", "h5py", "nibabel", "pydantic")


def modules_of_help(command):
    """What is imported for a command's help."""
    code = f"import sys; from ostiform.cli import application; application({command!r})("
    code += f"{[*command.split(), '--help']!r}, result_action='return_value'); print(*sys.modules)"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(found.stdout.splitlines()[-1].split())


def test_help_waits_for_no_numerical_library():
    assert modules_of_help("").isdisjoint({"numpy", "rich.markdown", *HEAVY})


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_help_of_a_command_waits_for_nothing_that_works(command):
    assert modules_of_help(command).isdisjoint(HEAVY)


def test_help_of_a_command_is_its_docstring(capsys):
    cli.application("demo")(["demo", "--help"], result_action="return_value")
    printed = capsys.readouterr().out
    assert "true correspondence kept aside" in printed
    assert "--workers" in printed


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["bould"], 'Did you mean "build"?'),
        (["build"], "expected a value for --study, found none"),
        (["build", "x", "--wrkers", "3"], "Did you mean --workers?"),
        (["build", "x", "-w", "three"], 'unable to convert "three" into int'),
    ],
)
def test_a_wrong_option_is_one_sentence_that_says_where_to_look(arguments, expected):
    with pytest.raises(CycloptsError) as caught:
        cli.application()(arguments, exit_on_error=False, print_error=False)
    sentence = cli._sentence(caught.value)
    assert expected in sentence
    assert sentence.startswith("error: ")
    assert sentence.endswith("--help` lists what there is)")
    assert "\n" not in sentence


def test_a_wrong_option_is_input_and_ends_with_2(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["ostiform", "build", "x", "--wrkers", "3"])
    with pytest.raises(SystemExit) as caught:
        cli._run()
    assert caught.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("raised", "code"), [(KeyboardInterrupt(), 130), (BrokenPipeError(), 1)], ids=["Ctrl-C", "pipe"]
)
def test_whatever_ends_a_run_outside_of_a_command_has_its_code(monkeypatch, raised, code):
    def application(command):
        def run(*_, **__):
            raise raised

        return run

    monkeypatch.setattr(cli, "application", application)
    monkeypatch.setattr(os, "dup2", lambda *_: None)
    monkeypatch.setattr(os, "_exit", sys.exit)
    with pytest.raises(SystemExit) as caught:
        cli._run()
    assert caught.value.code == code


@pytest.mark.parametrize("kind", [OstiformError, *EXIT_CODES])
def test_every_error_has_its_exit_code_and_is_one_sentence(kind, capsys):
    def work(on_event):
        raise kind("x.vtp: expected a mesh, found none")

    assert run_command(COMMON, work) == EXIT_CODES.get(kind, 1)
    assert capsys.readouterr().err == "error: x.vtp: expected a mesh, found none\n"


@pytest.mark.parametrize(
    ("raised", "code", "said"),
    [
        (OSError(28, "No space left on device", "/data/x"), 1, "/data/x: expected to read and"),
        (MemoryError(), 1, "fewer workers (-w 1)"),
        (KeyboardInterrupt(), 130, "run the same command again to go on"),
    ],
)
def test_what_the_machine_refuses_is_a_sentence_too(raised, code, said, capsys):
    def work(on_event):
        raise raised

    assert run_command(COMMON, work) == code
    assert said in capsys.readouterr().err


def test_debug_shows_the_traceback(capsys):
    def work(on_event):
        raise InputError("no")

    run_command(Common(debug=True), work)
    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("count", [0, -3])
def test_a_number_of_workers_below_one_is_refused(count):
    with pytest.raises(InputError, match="--workers: expected at least 1"):
        worker_count(Common(workers=count))


def tell_all(on_event):
    on_event(Progress("embed", 0, 2))
    on_event(Progress("embed", 1, 2, "S1/0"))
    on_event(Warn("S2/0 left out: because"))
    on_event(Progress("embed", 2, 2, "S2/0"))
    on_event(Note("report: out/report.html"))


def test_a_pipe_gets_one_line_per_step(capsys):
    with watching(quiet=False, verbose=False) as on_event:
        tell_all(on_event)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "warning: S2/0 left out: because"
    assert re.fullmatch(r"embed: 2/2 in \d+\.\d s", lines[1])
    assert lines[2] == "report: out/report.html"


def test_verbose_adds_a_line_for_every_shape(capsys):
    with watching(quiet=False, verbose=True) as on_event:
        tell_all(on_event)
    assert "embed 1/2: S1/0" in capsys.readouterr().err


def test_quiet_keeps_the_warnings(capsys):
    with watching(quiet=True, verbose=False) as on_event:
        tell_all(on_event)
    assert capsys.readouterr().err == "warning: S2/0 left out: because\n"


def test_the_pace_is_a_rate_and_what_is_left():
    column = _Pace()
    with RichProgress() as progress:
        progress.add_task("embed", total=10)
        assert column.render(progress.tasks[0]).plain == ""
        for completed, elapsed, expected in (
            (5, 2.0, "2.5/s, 0:00:02 left"),
            (4, 40.0, "10.0 s each, 0:01:00 left"),
        ):
            fake = SimpleNamespace(completed=completed, elapsed=elapsed, total=10, finished=False)
            assert column.render(fake).plain == expected  # type: ignore[arg-type]
        fake = SimpleNamespace(completed=10, finished_time=20.0, total=10, finished=True)
        assert column.render(fake).plain == "2.0 s each"  # type: ignore[arg-type]


TERMINAL = """
import time
from ostiform.cli.watch import watching
from ostiform.pipeline.events import Progress
with watching(False, False) as on_event:
    for done in range(4):
        on_event(Progress("embed", done, 3, f"S{done}/0"))
        time.sleep(0.15)
"""


def test_a_terminal_gets_one_bar_with_rate_and_remaining_time():
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm", COLUMNS="100")
        os.execv(sys.executable, [sys.executable, "-c", TERMINAL])
    written, end = b"", time.monotonic() + 60.0
    while time.monotonic() < end:
        if select.select([terminal], [], [], 0.2)[0]:
            try:
                chunk = os.read(terminal, 65536)
            except OSError:  # the other side was closed
                break
            if not chunk:
                break
            written += chunk
    os.close(terminal)
    assert os.waitpid(pid, 0)[1] == 0
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", written.decode())
    assert re.search(r"embed .* 2/3 .*(/s|s each), 0:00:0\d left", text)
    assert text.replace("\r", "\n").rstrip().splitlines()[-1].startswith("embed")


def summary(*failures):
    return Summary(Path("out"), shapes=3, failures=failures, seconds={"embed": 2.4})


def test_the_summary_names_the_shapes_left_out(capsys):
    failure = Failure(ShapeId("S2", "0", 0.0), "read", "because")
    assert show_summary(COMMON, summary(failure)) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("2 of 3 shapes used, 2 s, results in out")
    assert "left out: S2/0 (read): because" in printed


def test_json_is_all_that_is_on_standard_output(capsys):
    show_summary(Common(json=True), summary())
    assert json.loads(capsys.readouterr().out)["used"] == 3


def test_quiet_says_nothing_when_all_is_well(capsys):
    assert show_summary(Common(quiet=True), summary()) == 0
    assert capsys.readouterr().out == ""


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_scripts_know_the_commands(shell, tmp_path):
    script = cli.application().generate_completion(prog_name="ostiform", shell=shell)
    for name in cli.COMMANDS:
        assert name in script
    if shutil.which(shell):
        path = tmp_path / "script"
        path.write_text(script, encoding="utf-8")
        subprocess.run([shell, "-n", str(path)], check=True, capture_output=True)


def test_completion_is_installed_for_the_shell_named(tmp_path):
    done = ostiform("--install-completion", "--shell", "bash", HOME=str(tmp_path))
    assert done.returncode == 0, done.stderr
    written = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert any("ostiform" in path.read_text(encoding="utf-8") for path in written)


def test_the_program_says_its_version():
    from ostiform import __version__

    assert ostiform("--version").stdout.strip() == __version__


def test_a_study_that_is_not_there_is_one_sentence():
    done = ostiform("check", "nowhere.toml")
    assert done.returncode == 2
    assert done.stderr == "error: nowhere.toml: expected a study file, found none: check the path\n"


def test_artifact_errors_have_the_code_that_the_documentation_states():
    assert EXIT_CODES[ArtifactError] == 6
