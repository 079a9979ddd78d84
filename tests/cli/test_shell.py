"""Features for shells: standard streams instead of files, JSON, completion and manual page."""

import io
import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.command_output import SCENE, keys, names, parsed

from lmpchain import Scene, Trajectory
from lmpchain.cli import common, main
from lmpchain.cli.verbs import GROUPS, VERBS

MEASURED = SCENE + 'quantities = ["arrival_time", "peak_force:5"]\n'


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "scene.toml"
    path.write_text(MEASURED)
    return path


def give(text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO(text))


# --- JSON


def test_the_numbers_of_a_run_are_one_json_object_on_standard_output(scene: Path, capsys):
    assert main(["run", str(scene), "--json"]) == 0
    said = capsys.readouterr()
    told = json.loads(said.out)
    run = Trajectory.load(scene.with_suffix(".nc"))
    assert (told["engine"], told["equation"], told["grains"]) == (run.engine, 1, 20)
    assert told["error"] == {
        "total": run.error_estimate.total,
        "model": 0.0,
        "solver": run.error_estimate.solver,
    }
    assert told["cost"] == run.cost._asdict()
    assert (told["tolerance"], told["tolerance_met"]) == (1e-6, True)
    assert Path(told["file"]) == scene.with_suffix(".nc")
    arrival = told["quantities"]["arrival_time"]
    held = run.gathered["arrival_time"]
    assert arrival["unit"] == "s"
    assert [value is None for value in arrival["values"]] == np.isnan(held).tolist()
    assert [each for each in arrival["values"] if each] == held[held > 0].tolist()
    force = told["quantities"]["peak_force:5"]
    assert force == {
        "values": float(run.gathered["peak_force:5"]),
        "errors": float(run.gathered["peak_force:5_error"]),
        "unit": "N",
    }
    # The readable text is on standard error, with the same numbers.
    assert f"peak_force:5     {force['values']:.6g} N" in said.err


def test_a_missed_tolerance_is_part_of_the_json_object(scene: Path, capsys):
    assert main(["run", str(scene), "--engine", "modes", "--json", "numbers.json"]) == 1
    told = json.loads(Path("numbers.json").read_text())
    assert told["tolerance_met"] is False
    assert told["error"]["model"] > told["tolerance"]
    assert "numbers: numbers.json" in capsys.readouterr().out
    words = ["run", str(scene), "--force", "--step", "1e-8", "--json"]
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["tolerance"] is None


def test_a_resumed_run_prints_the_same(scene: Path, capsys):
    assert main(["run", str(scene), "-o", "job/", "--json"]) == 0
    first = json.loads(capsys.readouterr().out)
    assert main(["resume", "job", "--json"]) == 0
    again = json.loads(capsys.readouterr().out)
    assert first["folder"] == "job"
    assert again["quantities"] == first["quantities"]
    assert again["error"] == first["error"]


def test_other_numbers_go_to_standard_output(scene: Path, capsys):
    assert main(["plan", str(scene), "--json", "numbers.json"]) == 0
    capsys.readouterr()
    assert main(["plan", str(scene), "--json", "-"]) == 0
    said = capsys.readouterr()
    told = json.loads(said.out)
    assert told["engine"] == json.loads(Path("numbers.json").read_text())["engine"]
    assert told["engine"] in said.err
    assert names(Path()) == ["numbers.json", "scene.toml"]


# --- standard input and output instead of files


def test_a_scene_is_read_from_standard_input(scene: Path, monkeypatch, capsys):
    Path("push.csv").write_text("time,force\n" + "".join(f"{n}e-6,{n % 3}\n" for n in range(20)))
    text = re.sub(r'kind = "impulse"\nvelocity = .*', 'kind = "force"\nfile = "push.csv"', MEASURED)
    give(text, monkeypatch)
    assert main(["run", "-", "-o", "pushed.nc"]) == 0
    # A file that the scene names is in the current folder.
    Path("pushed.toml").write_text(text)
    assert Trajectory.load("pushed.nc").scene == Scene.from_toml("pushed.toml")
    capsys.readouterr()
    give(MEASURED, monkeypatch)
    assert main(["run", "-"]) == 2
    assert keys(capsys.readouterr()) == ["output"]
    give("[chain\n", monkeypatch)
    assert main(["plan", "-"]) == 2
    assert capsys.readouterr().err.startswith("error: standard input: is not valid TOML")


def test_standard_output_contains_only_traces(scene: Path, capsys):
    assert main(["run", str(scene)]) == 0
    choice = ["--velocity", "3", "--energies"]
    assert main(["export", "scene.nc", "-o", "traces.csv", *choice]) == 0
    capsys.readouterr()
    assert main(["export", "scene.nc", "-o", "-", *choice]) == 0
    said = capsys.readouterr()
    assert said.out == Path("traces.csv").read_text()
    assert said.err == ""


def test_an_example_goes_to_standard_output(scene: Path, capsys):
    assert main(["new", "-", "--example", "dimer"]) == 0
    text = capsys.readouterr().out
    assert main(["new", "dimer.toml", "--example", "dimer"]) == 0
    assert Scene.from_text(text) == Scene.from_toml("dimer.toml")
    assert "lmpchain run scene.toml" in text


@pytest.mark.parametrize(
    "words",
    [
        ["run", "scene.toml", "-o", "-"],
        ["explore", "scene.toml", "-o", "-", "--over", "chain.gravity=1:2"],
        ["compare", "scene.toml", "-o", "-"],
        ["workprec", "scene.toml", "-o", "-", "--json"],
    ],
)
def test_pages_pictures_and_runs_are_files(words: list[str], scene: Path, capsys):
    assert main(words) == 2
    assert keys(capsys.readouterr()) == ["-"]
    assert names(Path()) == ["scene.toml"]


# --- one meaning of each option


def test_an_option_takes_the_same_everywhere():
    """Each spelling has one type of value, except for the file that -o names.

    The integrators of `deck` are listed as choices, those of other engines depend on the engine.
    """
    seen: dict[str, set[object]] = {}
    for verb in VERBS.values():
        for spelled, options in (*verb.arguments, *verb.choice):
            kind = options.get("metavar", options.get("action", "choice"))
            seen.setdefault(spelled[-1], set()).add((kind, options.get("type")))
    different = {name for name, kinds in seen.items() if len(kinds) > 1}
    assert {name for name in different if name.startswith("-")} == {"--output", "--integrator"}


@pytest.mark.parametrize(
    ("verb", "earlier", "today"),
    [
        ("orbit", "--of=force:3", "--draw=force:3"),
        ("sensitivity", "--of=momentum:3", "--answer=momentum:3"),
        ("sensitivity", "--youngs-modulus=0.1", "--sigma-youngs-modulus=0.1"),
        ("sensitivity", "--tolerance=1e-3", "--derivative-tolerance=1e-3"),
        ("averages", "--tolerance=1e-3", "--energy-tolerance=1e-3"),
        ("export", "--energy", "--energies"),
    ],
)
def test_an_earlier_spelling_means_the_same(verb: str, earlier: str, today: str, capsys):
    needed = {"sensitivity": ["--answer=energy:1"], "averages": ["--of", "a"]}
    rest = ["a", *needed.get(verb, []), *(["-o", "b"] if verb == "export" else [])]
    arguments = parsed(verb, *rest, *today.split("="))
    assert parsed(verb, *rest, *earlier.split("=")) == arguments
    assert parsed(verb, *rest, earlier) == arguments
    assert main([verb, "--help"]) == 0
    assert f"{earlier.partition('=')[0]} " not in capsys.readouterr().out


# --- messages on terminals


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_messages_are_wrapped_on_terminals(monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setenv("NO_COLOR", "1")
    path = "/".join(["folder"] * 20) + "-with-hyphens.toml"
    text = f"chain.cells: unknown key; the keys here are {', '.join(['diameter'] * 30)} {path} end"
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    common.complain(text)
    lines = re.sub(r"\x1b\[\d*m", "", screen.getvalue()).splitlines()
    assert lines[0].startswith("error: chain.cells: unknown key")
    assert all(line.startswith("  ") for line in lines[1:])
    # Text to be copied is not wrapped.
    assert f"  {path}" in lines
    assert max(len(line) for line in lines if path not in line) <= 80
    assert " ".join(map(str.strip, lines)) == f"error: {text}"


# --- completion and the manual page


def completions(line: str, script: Path) -> list[str]:
    """Return the completions that bash proposes for the last word of a command line."""
    words = line.split(" ")
    program = (
        f"source {script}; COMP_WORDS=({' '.join(words[:-1])} '{words[-1]}'); "
        f"COMP_CWORD={len(words) - 1}; COMP_LINE='{line}'; COMP_POINT={len(line)}; "
        "_shtab_lmpchain; printf '%s\\n' \"${COMPREPLY[@]}\""
    )
    done = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=True)
    return done.stdout.split()


def test_bash_completes_commands_options_and_files(scene: Path, capsys):
    pytest.importorskip("shtab")
    assert main(["--print-completion", "bash"]) == 0
    script = Path("completion.bash")
    script.write_text(capsys.readouterr().out)
    assert completions("lmpchain se", script) == ["sensitivity"]
    assert set(completions("lmpchain ", script)) == set(VERBS)
    assert completions("lmpchain run --tol", script) == ["--tolerance"]
    assert completions("lmpchain deck --integrator k", script) == ["kahan-li6"]
    assert completions("lmpchain run sce", script) == ["scene.toml"]
    assert completions("lmpchain run --engine sce", script) == []
    assert "--of" not in completions("lmpchain orbit --", script)
    for shell in ("zsh", "tcsh"):
        assert main(["--print-completion", shell]) == 0
        assert "sensitivity" in capsys.readouterr().out


def test_completion_without_shtab_names_the_package(monkeypatch: pytest.MonkeyPatch, capsys):
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["--print-completion", "bash"]) == 1
    assert "pip install 'lmpchain[completion]'" in capsys.readouterr().err
    assert main(["--print-completion", "fish"]) == 2


def test_the_manual_lists_every_command_and_option(capsys):
    assert main(["--print-manual"]) == 0
    page = capsys.readouterr().out
    plain = page.replace(r"\-", "-")
    for name, verb in VERBS.items():
        part = plain.split(f".SS {name}\n")[1].split("\n.SS ")[0]
        for spelled, _ in (*verb.arguments, *verb.choice):
            assert not spelled[-1].startswith("-") or spelled[-1] in part
        assert f"Example: lmpchain {verb.example}" in part
    # The groups of commands keep their lines; the other paragraphs are filled.
    shown = plain.split(".SH DESCRIPTION\n")[1].split("\n.SH OPTIONS")[0]
    assert main(["--help"]) == 0
    purpose, *groups = capsys.readouterr().out.split("\n\n")[1 : len(GROUPS) + 2]
    filled = [f".PP\n.nf\n{group}\n.fi" for group in groups]
    assert shown == "\n".join([f".PP\n{purpose}", *filled])
    sections = ["NAME", "SYNOPSIS", "DESCRIPTION", "OPTIONS", "COMMANDS", "EXIT STATUS"]
    assert re.findall(r"^\.SH (.*)", page, re.MULTILINE) == sections
    assert plain.split(".SH EXIT STATUS\n")[1].startswith("Exit codes: 0 done, 1 the run failed")
    assert not re.search(r"^'|^\.(?!TH|SH|SS|TP|PP|nf|fi|B|RI)", page, re.MULTILINE)
