"""The pages in `docs/`: links, examples, commands, gallery, build, and measured tables."""

import ast
import doctest
import importlib
import inspect
import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers.browser import Browser, browser, installed
from helpers.child_processes import PATIENCE
from helpers.example_scenes import scene_of
from helpers.modules import listed_names
from matplotlib.figure import Figure

import lmpchain
from lmpchain import Chain, Impulse, Scene, simulate
from lmpchain.cli import main
from lmpchain.engines.lammps.export import write_deck

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.glob("*.md"))
SPEEDS = ROOT / "analysis" / "speed.md"
GALLERY = sorted((DOCS / "gallery").glob("plot_*.py"))
NAMES = [page.stem for page in PAGES]
SHORT = scene_of(Chain(grains=20, diameter=1e-3), Impulse(velocity=1e-5), 4e-5, 61)


def blocks(page: str, language: str) -> list[str]:
    """Return the code blocks of a page in a language."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return re.findall(rf"^```{re.escape(language)}\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


def places(page: Path) -> set[str]:
    """Return the anchors of the headings of a page, as Markdown renderers make them."""
    text = page.read_text(encoding="utf-8")
    for source, start in re.findall(r"```{include} (\S+)\n:start-after: \"(.*)\"", text):
        text += (page.parent / source).read_text(encoding="utf-8").split(start)[1]
    titles = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).replace(" ", "-") for title in titles}


def text_of(page: Path) -> str:
    """Return the text of a page with the tables that it includes."""
    return re.sub(
        r"^```{include} (\.\./analysis/tables/\w+\.md)\n```$",
        lambda table: (page.parent / table[1]).read_text(encoding="utf-8"),
        page.read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )


NAMED = re.compile(r"`([\w./-]+\.py)`|\b((?:lmpchain|analysis|tests|docs)/[\w./-]+\.py)\b")


def test_files_named_on_pages_exist():
    """A page may name a file by the end of its path, such as `engines/base.py`."""
    folders = ("lmpchain", "analysis", "tests", "docs")
    files = [
        f"/{file.relative_to(ROOT)}" for name in folders for file in (ROOT / name).rglob("*.py")
    ]
    pages = [ROOT / "README.md", *(ROOT / "analysis").rglob("*.md"), *PAGES]
    named = {
        (page.name, one or other)
        for page in pages
        for one, other in NAMED.findall(page.read_text(encoding="utf-8"))
    }
    assert len(named) > 50
    assert not {
        (page, name) for page, name in named if not any(x.endswith(f"/{name}") for x in files)
    }


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", ROOT / "analysis" / "README.md", *PAGES], ids=lambda p: p.stem
)
def test_links_lead_somewhere(page: Path):
    text = re.sub(
        r"^```\w.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        name, _, place = link.partition("#")
        if "://" in name:
            continue
        target = page.parent / name if name else page
        if "measurements/" in name:  # These pages are made from the gallery.
            target = (
                DOCS
                / "gallery"
                / Path(name).with_suffix(".py").name.replace("index.py", "GALLERY_HEADER.rst")
            )
        assert target.exists(), link
        assert not place or place in places(target), link


def test_cited_equations_are_on_the_pages():
    """The pages have the equations by their numbers in the paper, as links when they are built."""
    model = (DOCS / "model.md").read_text(encoding="utf-8")
    assert re.findall(r"^\$\$ \(eq-(\d+)\)$", model, re.MULTILINE) == [
        str(number) for number in range(1, 36)
    ]
    sources = [*DOCS.glob("*.md"), *(ROOT / "lmpchain").rglob("*.py")]
    # The expressions with which the pages are built.
    links = runpy.run_path(str(DOCS / "equations.py"))
    cited = set()
    for source in sources:
        for citation in links["CITED"].findall(source.read_text(encoding="utf-8")):
            cited.update(map(int, links["NUMBER"].findall(citation)))
    assert cited
    assert cited <= set(range(1, 36))


def test_every_page_is_in_the_contents():
    index = (DOCS / "index.md").read_text(encoding="utf-8")
    listed = "\n".join(
        re.findall(r"```{toctree}\n(.*?)^```$", index, re.DOTALL | re.MULTILINE)
    ).split()
    assert {*NAMES, "measurements/index"} - {"index"} <= set(listed)


def test_the_reference_lists_all_public_names():
    text = (DOCS / "api.md").read_text(encoding="utf-8")
    for package in (lmpchain, lmpchain.measure, lmpchain.theory):
        for name in package.__all__:
            assert re.search(rf"\b{name}\b", text), f"{package.__name__}.{name}"


def test_pages_of_the_reference_differ_by_more_than_case():
    """On macOS and Windows, names that differ only by case are one file."""
    settings = ast.parse((DOCS / "conf.py").read_text(encoding="utf-8"))
    (chosen,) = [
        ast.literal_eval(line.value)
        for line in settings.body
        if isinstance(line, ast.Assign) and ast.unparse(line.targets) == "autosummary_filename_map"
    ]
    names = set(listed_names())
    assert set(chosen) <= names
    files = [chosen.get(name, name).lower() for name in names]
    assert sorted(files) == sorted(set(files))


@pytest.mark.slow
def test_pictures_of_the_gallery_are_described_by_their_titles(tmp_path: Path):
    """A separate process is used, because the gallery changes settings of lmpchain."""
    (tmp_path / "images").mkdir()
    script = tmp_path / "plot_1.py"
    script.write_text('"""\nA wave in a row\n===============\n"""\n')
    program = textwrap.dedent(f"""
        import gallery_pictures
        from matplotlib.figure import Figure
        names = {{
            "example_globals": {{"picture": Figure()}},
            "image_path_iterator": iter(["images/one.png"]),
            "src_file": {str(script)!r},
        }}
        print(gallery_pictures.scraper(("", "", 0), names, {{"src_dir": {str(tmp_path)!r}}}))
        from docutils.core import publish_doctree
        page = publish_doctree(".. image:: one.png\\n   :alt:\\n\\n`A title <plot_1.html>`_\\n")
        gallery_pictures.describe_thumbnails(None, page, "measurements/index")
        print(page.pformat())
    """)
    done = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        check=True,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(DOCS)},
    )
    assert ":alt: A wave in a row" in done.stdout
    assert '<image alt="A title" uri="one.png">' in done.stdout
    assert (tmp_path / "images" / "one.png").is_file()


def test_upright_letters_stay_upright_under_an_exponent():
    """A single letter is in italics in MathML unless it is marked as upright."""
    typeset = runpy.run_path(str(DOCS / "equations.py"))["typeset"]
    for formula in re.findall(r"\$([^$]*\\mathrm[^$]*)\$", (DOCS / "model.md").read_text()):
        upright = re.findall(r"\\mathrm(?: (\w)|{(\w)})", formula)
        shown = typeset(formula)
        for letter in filter(None, sum(upright, ())):
            code = f"&#x{ord(letter):05X};"
            assert (
                f"<mtext>{letter}</mtext>" in shown
                or f'"normal">{code}' in shown
                or (f'"normal">{letter}<' in shown)
            ), formula
            assert f"<msup><mi>{letter}<" not in shown
            assert f"<msup><mi>{code}<" not in shown


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [name for name in NAMES if "\n>>> " in (DOCS / f"{name}.md").read_text()]
)
def test_examples(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    results = doctest.testfile(
        str(DOCS / f"{page}.md"), module_relative=False, optionflags=doctest.ELLIPSIS
    )
    assert results.attempted > 0
    assert results.failed == 0


def test_every_block_is_tested():
    """Pages contain only known kinds of blocks, and a test executes or reads each of them."""
    for page in NAMES:
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
        assert "+SKIP" not in text
        kinds = set(re.findall(r"^```(\S+)", text, re.MULTILINE))
        assert kinds <= {
            "python",
            "{bibliography}",
            "sh",
            "toml",
            "text",
            "{code-cell}",
            "{eval-rst}",
            "{include}",
            "{toctree}",
        }, page
        loose = [block for block in blocks(page, "python") if ">>> " not in block]
        assert len(loose) == (page == "lammps"), page  # Executed by test_the_page_reads_a_dump.
        assert bool(blocks(page, "toml")) == (page in ("scenes", "production", "instruments"))


def test_the_page_reads_a_dump(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    chain = Chain(grains=10, material="glass", diameter=1e-3)
    scene = Scene(chain=chain, excitation=Impulse(velocity=1e-3), duration=1e-5, samples=5)
    write_deck(scene, tmp_path, step=1e-7)
    monkeypatch.chdir(tmp_path)
    subprocess.run(
        [Path(sys.executable).with_name("lmp"), "-in", "in.column"], check=True, capture_output=True
    )
    (example,) = (block for block in blocks("lammps", "python") if "MDAnalysis." in block)
    names: dict = {}
    exec(example, names)
    t = simulate(scene, "native", tolerance=1e-9)
    assert names["displacement"].shape == (5, 10)
    assert (
        np.abs(names["displacement"] - t.displacement).max() < 1e-2 * np.abs(t.displacement).max()
    )


def test_scene_files_of_the_page(tmp_path: Path):
    paper, grains, law, ground, striker, damping = blocks("scenes", "toml")
    (tmp_path / "grains.csv").write_text(blocks("scenes", "text")[0])
    for text in (paper, grains, f"{grains}\n{damping}"):
        (tmp_path / "scene.toml").write_text(text)
        assert Scene.from_toml(tmp_path / "scene.toml").samples == 101
    (tmp_path / "scene.toml").write_text(striker)
    assert Scene.from_toml(tmp_path / "scene.toml").chain.load_grain == 2
    (tmp_path / "scene.toml").write_text(f"{paper}\n{law}")
    assert Scene.from_toml(tmp_path / "scene.toml").chain.law.parameters == (1e4,)
    (tmp_path / "scene.toml").write_text(f"{paper}\n{ground}")
    assert Scene.from_toml(tmp_path / "scene.toml").chain.ground_stiffness[0] == 1e6
    (tmp_path / "scene.toml").write_text(f"{paper}\n{damping}")
    assert Scene.from_toml(tmp_path / "scene.toml").chain.damped


def test_the_scene_file_of_an_instrument(tmp_path: Path):
    (scene,) = blocks("instruments", "toml")
    (tmp_path / "scene.toml").write_text(scene)
    lines = (DOCS / "instruments.md").read_text(encoding="utf-8").split('"""')[1].splitlines()
    (tmp_path / "scope.csv").write_text("\n".join(line.removeprefix("... ") for line in lines))
    assert Scene.from_toml(tmp_path / "scene.toml").excitation.force.max() == pytest.approx(2.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", [name for name in NAMES if blocks(name, "sh") and name != "production"]
)
def test_commands(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Commands of the page on production are in `test_production_page`."""
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "templates").symlink_to(ROOT / "templates")
    SHORT.to_toml("scene.toml")
    said = ""
    for line in "".join(blocks(page, "sh")).splitlines():
        command, _, remark = line.partition("  # ")
        wanted = int((re.search(r"exit code (\d+)", remark) or [0, 0])[1])
        # Commands run in this process, which has compiled everything, unless they need a shell.
        if command.startswith("lmpchain ") and not set("|>") & set(command):
            code = main(shlex.split(command)[1:])
            fault = capsys.readouterr().err
        else:
            done = subprocess.run(
                ["bash", "-c", command],
                capture_output=True,
                text=True,
                check=False,
                timeout=PATIENCE,
            )
            code = done.returncode
            fault = done.stderr
        assert code == wanted, f"{line}\n{fault}"
        assert "Traceback" not in fault
        said += fault
    if page == "faq":
        for message in blocks(page, "text"):
            assert message in said
    if page == "lammps":
        assert len(Path("mine/ke.txt").read_text().splitlines()) > 10


@pytest.mark.slow
def test_the_page_shows_the_output_of_a_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """The scene is from the examples; digits at rounding level may differ."""
    monkeypatch.chdir(tmp_path)
    scene = ROOT / "analysis" / "scenes" / "fig5_1g.toml"
    assert main(["deck", str(scene), "-o", "mine", "--step", "2e-7"]) == 0
    lammps = Path(sys.executable).with_name("lmp")
    subprocess.run([lammps, "-in", "in.column"], cwd="mine", check=True, capture_output=True)
    capsys.readouterr()
    checked = ["check", "mine/column.lammpstrj", "--scene", str(scene), "--tolerance", "1e-3"]
    assert main(checked) == 0
    (shown,) = blocks("accuracy", "text")
    printed = capsys.readouterr().out.splitlines()
    for line, expected in zip(printed, shown.splitlines(), strict=False):
        for word, number in zip(line.split(), expected.split(), strict=True):
            if re.fullmatch(r"[\d.]+(e-\d+)?", number):
                assert float(word) == pytest.approx(float(number), rel=0.3), line
            else:
                assert word == number, line


def classes_that_plot() -> list[type]:
    """Return the classes with a method `plot`."""
    found = []
    for path in (ROOT / "lmpchain").rglob("*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and "plot" in (
                getattr(part, "name", "") for part in node.body
            ):
                found.append(getattr(importlib.import_module(module), node.name))
    return found


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_gallery_draws_every_plot(monkeypatch: pytest.MonkeyPatch):
    drawn: set[type] = set()

    def noted(kind: type) -> Callable[..., Any]:
        draw = kind.plot  # type: ignore[attr-defined]

        def plot(self: Any, *arguments: Any, **options: Any) -> Any:
            drawn.add(kind)
            return draw(self, *arguments, **options)

        return plot

    monkeypatch.setenv("MPLBACKEND", "agg")
    everything = classes_that_plot()
    for kind in everything:
        monkeypatch.setattr(kind, "plot", noted(kind))
    for script in GALLERY:
        names = runpy.run_path(str(script))
        shown = re.findall(r"^picture\w*", script.read_text(encoding="utf-8"), re.MULTILINE)
        assert shown, script.name
        assert all(isinstance(names[name].figure, Figure) for name in shown), script.name
    assert set(everything) == drawn


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_the_tutorial_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setenv("MPLBACKEND", "agg")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    for cell in blocks("tutorial", "{code-cell} ipython3"):
        exec(cell, names)
    assert capsys.readouterr().out.rstrip().endswith("True")


TARGETS = (1e-3, 1e-6, 1e-9, 1e-12)


@pytest.mark.parametrize(("number", "scene"), list(enumerate(["fig5_1g", "fig1", "ten_thousand"])))
def test_times_of_native_on_the_page_on_speed(number: int, scene: str):
    """Each row has the times of its label: no run to a tolerance represents a fixed step."""
    tables = SPEEDS.read_text(encoding="utf-8").split("\n\n|")
    table = [t for t in tables if "| native, the best integrator at a fixed step |" in t][number]
    kept = json.loads((ROOT / "analysis" / "other_codes" / f"{scene}.json").read_text())["rows"]
    fixed = [row for row in kept if re.fullmatch(r"native [\w-]+", row["code"])]
    chosen = {
        "the best integrator at a fixed step": fixed,
        "to a tolerance, without its error estimate": [
            r for r in kept if r["code"].endswith("integration alone")
        ],
        "to a tolerance, with its error estimate": [
            r for r in kept if r["code"].endswith("with estimate")
        ],
    }
    for label, rows in chosen.items():
        (line,) = re.findall(rf"^\| native,? {label} \| (.*) \|$", table, re.MULTILINE)
        best = [
            min((1e6 * r["seconds"] for r in rows if r["error"] <= target), default=None)
            for target in TARGETS
        ]
        cells = ["never" if x is None else f"{float(f'{x:.3g}'):,.10g}" for x in best]
        assert line.split(" | ") == cells, label


@pytest.mark.parametrize("scene", ["fig5_1g", "fig1"])
def test_times_of_discrete_element_codes_on_the_page_on_speed(scene: str):
    kept = json.loads((ROOT / "analysis" / "other_codes" / f"{scene}.json").read_text())["rows"]
    page = SPEEDS.read_text(encoding="utf-8").replace(",", "")
    for code in ("LAMMPS", "LIGGGHTS", "Yade"):
        rows = [row for row in kept if row["code"].startswith(code)]
        best = (
            min((1e6 * r["seconds"] for r in rows if r["error"] <= target), default=None)
            for target in TARGETS
        )
        cells = " | ".join("never" if x is None else f"{float(f'{x:.3g}'):.10g}" for x in best)
        assert re.search(rf"^\| {code}.* \| {cells} \|$", page, re.MULTILINE), (code, cells)


def test_long_columns_in_lammps_on_the_page_on_speed(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "analysis")
    script = importlib.import_module("lammps_overhead")
    page = SPEEDS.read_text(encoding="utf-8")
    rows = json.loads(script.KEPT.read_text(encoding="utf-8"))["rows"]
    assert {row["grains"]: row["steps"] for row in rows} == script.COLUMNS
    for row in rows:
        assert script.line(row) in page.splitlines()


def test_times_in_the_readme_agree_with_the_page():
    page = text_of(SPEEDS)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (?:native|LAMMPS),? .*\d.*$", readme, re.MULTILINE)
    assert len(rows) == 3
    assert set(rows) <= set(page.splitlines())
    fastest = re.search(r"^\| the fastest of SciPy, .* heyoka \| (.*) \|$", readme, re.MULTILINE)
    weak, _, _ = page.replace(",", "").partition("The same for a strong strike")
    peers = re.findall(
        r"^\| (?:SciPy|numbalsoda|heyoka).*? \| (\S+) \| (\S+) \| (\S+) \| (\S+) \|$",
        weak,
        re.MULTILINE,
    )
    assert len(peers) > 3
    assert fastest[1].split(" | ") == [min(cells, key=float) for cells in zip(*peers, strict=True)]


def test_whole_calls_in_the_readme_agree_with_the_page():
    """The README has µs to two and three digits, the page ms."""
    calls = re.search(
        r"^\| 0\.857 mm/s, 1e-3 .*\n(?:\| 1e-\d+ .*\n){3}", text_of(SPEEDS), re.MULTILINE
    )
    rows = [[float(cell) for cell in line.split(" | ")[1:-1]] for line in calls[0].splitlines()]
    ours, theirs = (
        re.search(rf"^\| {label} \| (.*) \|$", (ROOT / "README.md").read_text("utf-8"), re.M)[1]
        for label in (
            "a whole call: the scene, its 101 samples and their estimate",
            "a whole call of numbalsoda, without an estimate",
        )
    )
    made = [f"{float(f'{1e3 * (scene + call):.2g}'):,.0f}" for scene, call, *_ in rows]
    assert made == ours.split(" | ")
    assert [f"{float(f'{1e3 * row[5]:.3g}'):,.0f}" for row in rows] == theirs.split(" | ")


TABLES = sorted((ROOT / "analysis" / "tables").glob("*.md"))


@pytest.mark.parametrize("table", TABLES, ids=lambda path: path.stem)
def test_a_table_written_by_a_script_is_on_one_page(table: Path):
    """The page names the script, and the script names the table and the page."""
    include = f"```{{include}} ../analysis/tables/{table.name}\n```"
    pages = [page for page in PAGES if include in page.read_text(encoding="utf-8")]
    assert len(pages) == 1
    scripts = [
        script
        for script in (ROOT / "analysis").rglob("*.py")
        if f"tables/{table.name}" in script.read_text(encoding="utf-8")
    ]
    assert len(scripts) == 1
    assert f"docs/{pages[0].name}" in scripts[0].read_text(encoding="utf-8")


def test_stored_tables_agree_with_the_pictures(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.syspath_prepend(ROOT / "analysis")
    importlib.import_module("kept_tables").main(tmp_path)
    made = list(tmp_path.iterdir())
    assert len(made) == 2
    for table in made:
        kept = ROOT / "analysis" / "tables" / table.name
        assert kept.read_text(encoding="utf-8") == table.read_text(encoding="utf-8")


def test_a_measured_number_is_on_one_page():
    """A measured number is on the page that names the script; other pages link to that page."""
    cited: dict[str, set[str]] = {}
    for page in [*DOCS.glob("*.md"), ROOT / "README.md"]:
        for script in re.findall(r"analysis/[\w/]+\.py", page.read_text(encoding="utf-8")):
            cited.setdefault(script, set()).add(page.name)
    assert len(cited) > 5
    assert [script for script, pages in cited.items() if len(pages) > 1] == []


# Quantities that several pages state, with a pattern whose groups match the number.
QUANTITIES = {
    "strike number at which linear theory is off by 1 %": (
        r"at the strike number (0\.\d+), and 10 %|v_0\^\* < (0\.\d+)\$, to 10 %"
        r"|thresholds (0\.\d+) and|below (0\.\d+) linear theory is right"
        r"|below (0\.\d+) for 1 %|at v0\* = (0\.\d+) and 10 %"
    ),
    "strike number at which linear theory is off by 10 %": (
        r"and 10 % at (0\.\d+)|to 10 % for (0\.\d+)|thresholds 0\.\d+ and (0\.\d+)"
    ),
    "strike number at which contact 1 opens": (
        r"contact 1 opens from (\d+\.\d)|column opens at (\d+\.\d)|, from (\d+\.\d) on contact 1"
    ),
    "error of linear theory in Fig. 5 at g": (
        r"and 28, (\d+), 144 % at|28 %, (\d+) % and 144|at 10 g, (\d+) % at g|28, (\d+), 144 % off"
    ),
    "time of a column of a sweep": r"(\d\.\d+ to \d\.\d+) ms of a core",
    "error of Eq. (7)": r"off by (\d+ to \d+) %, for the top|Eq\. \(7\) is (\d+ to \d+) % off",
    "shift at 1.05 times sound beside Toda's law": (
        r"from Toda's by (\d+) % at 1\.05|differ by [-−](\d+) % at 1\.05"
    ),
    "shift at 1.0125 times sound beside Toda's law": (
        r"and by (\d+) % at 1\.0125|and by [-−](\d+) % at 1\.0125"
    ),
    "mean kinetic energy of 38 beads off the ensemble": (
        r"mean to (\d\.\de-\d), variance|the mean to (\d\.\de-\d) and|mean comes to (\d\.\de-\d)"
    ),
    "variance of the kinetic energy of 38 beads off the ensemble": (
        r", variance to (\d\.\de-\d)|the variance to (\d\.\de-\d)"
    ),
    "largest error of linear theory in the paper's column at g": (
        r"stronger, is (\d+) % off|% off by the last and (\d+) % by the first"
    ),
    "frequencies at which two impurities are transparent": (
        r"(0\.\d+, 0\.\d+ and 0\.\d+) of (?:the|its) band edge"
    ),
    "Neimark-Sacker point of the acoustic rectifier": (
        r"Neimark-Sacker at (0\.\d+) µm|Neimark-Sacker point at (0\.\d+) µm; the second"
    ),
}


def said_of(form: str, texts: Mapping[str, str]) -> dict[str, set[str]]:
    """Return the numbers in this form on each page, without trailing zeros."""
    numbers = {
        page: {
            "".join(groups).rstrip("0") if "." in "".join(groups) else "".join(groups)
            for groups in (match.groups("") for match in re.finditer(form, " ".join(text.split())))
        }
        for page, text in texts.items()
    }
    return {page: said for page, said in numbers.items() if said}


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_pages_agree_on_quantities(quantity: str):
    """A page with a changed quantity is detected."""
    texts = {
        str(page): text_of(page)
        for page in (*DOCS.glob("*.md"), ROOT / "README.md", ROOT / "analysis" / "README.md")
    }
    said = said_of(QUANTITIES[quantity], texts)
    assert len(said) > 1, "it stands on one page alone"
    assert len(set.union(*said.values())) == 1, said
    page = next(iter(said))
    match = re.search(QUANTITIES[quantity], " ".join(texts[page].split()))
    number = next(filter(None, match.groups()))
    other = f"{number[:-1]}{(int(number[-1]) + 1) % 10}"
    changed = match[0].replace(number, other)
    texts[page] = texts[page].replace("\n", " ").replace(match[0], changed)
    assert said_of(QUANTITIES[quantity], texts) != said


@pytest.mark.parametrize(
    ("question", "place"),
    [
        ("install", "install.md"),
        ("first run", "tutorial.md"),
        ("contact law", "scenes.md"),
        ("mean", "prints.md"),
        ("engine", "engines.md"),
        ("dump", "lammps.md#a-dump-of-your-own"),
        ("oscilloscope", "instruments.md"),
        ("cluster", "production.md"),
    ],
)
def test_the_first_page_links_to_the_pages_for_newcomers(question: str, place: str):
    """The pages are one click away; `test_links_have_targets` checks the links."""
    rows = re.findall(r"^\| (.*\?) \| (.*) \|$", (DOCS / "index.md").read_text("utf-8"), re.M)
    assert len(rows) == 8
    assert any(question in asked and f"({place})" in answer for asked, answer in rows)


def public_functions() -> list[str]:
    """Return the dotted names of the functions that the reference shows."""
    found = []
    for entry in listed_names():
        package, _, name = entry.rpartition(".")
        try:
            thing = getattr(importlib.import_module(package), name)
        except AttributeError:
            thing = importlib.import_module(entry)
        if not hasattr(thing, "__path__") and not hasattr(thing, "__file__"):
            found += (
                [f"{thing.__module__}.{thing.__qualname__}"]
                if callable(thing) and not isinstance(thing, type)
                else []
            )
            continue
        for each in getattr(thing, "__all__", None) or [
            k for k in vars(thing) if not k.startswith("_")
        ]:
            value = getattr(thing, each)
            module = getattr(value, "__module__", "")
            of_ours = module == entry or (
                hasattr(thing, "__all__") and module.startswith("lmpchain.")
            )
            if callable(value) and not isinstance(value, type) and of_ours:
                found.append(f"{value.__module__}.{value.__qualname__}")
    return sorted(set(found))


@pytest.mark.slow
def test_functions_document_their_parameters_and_results():
    validate = pytest.importorskip(
        "numpydoc.validate", reason="numpydoc comes with lmpchain[docs]"
    ).validate
    names = public_functions()
    assert len(names) > 80
    wanted = {"PR01", "PR02", "PR03", "RT01", "YD01", "SS01"}
    faults = {
        name: [text for code, text in validate(name)["errors"] if code in wanted] for name in names
    }
    assert {name: texts for name, texts in faults.items() if texts} == {}


def test_functions_document_their_exceptions():
    """All exceptions that a function raises directly are listed."""
    for name in public_functions():
        module, _, function = name.rpartition(".")
        thing = inspect.unwrap(getattr(importlib.import_module(module), function))
        tree = ast.parse(textwrap.dedent(inspect.getsource(thing)))
        raises = (
            node
            for node in ast.walk(tree)
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call)
        )
        raised = {ast.unparse(node.exc.func).removesuffix(".at") for node in raises}
        section = (inspect.getdoc(thing) or "").partition("\nRaises\n")[2]
        assert all(error in section or "LmpchainError" in section for error in raised), name


def check_live_figures(build: Path, profile: Path):
    """Check that the figures of the first page exist, are small, and move in a browser."""
    index = (build / "index.html").read_text(encoding="utf-8")
    figures = re.findall(r'<iframe class="live-figure" src="([^"]*)"', index)
    assert len(figures) == 4
    assert all((build / figure).stat().st_size < 2e6 for figure in figures)
    # The figures must not contain the build path.
    assert not any(str(build) in (build / figure).read_text("utf-8") for figure in figures)
    if not installed():
        return
    with browser(profile) as shown:
        shown.open(build / "index.html", 1280, 1400)
        high = "document.querySelectorAll('iframe.live-figure')[{}].style.height.length > 0"
        shown.wait_for(high.format(0))
        move_live_figure(shown, figures[0])
        shown.run("document.querySelectorAll('details.live-preset')[2].open = true")
        shown.wait_for(high.format(2))
        assert not shown.run("document.querySelectorAll('details.live-preset')[0].open")
        assert shown.remarks == []


def move_live_figure(shown: Browser, figure: str) -> None:
    """Check that the pointer and the keyboard control a figure within a page."""
    shown.wait_for("document.documentElement.dataset.ready", frame=figure)
    place = "(({{x, y, width, height}}) => [x, y, width, height])({}.getBoundingClientRect())"

    def click(element: str) -> None:
        left, top, _, _ = shown.run(place.format("document.querySelector('iframe.live-figure')"))
        x, y, width, height = shown.run(place.format(f"document.{element}"), figure)
        shown.click(left + x + width / 2, top + y + height / 2)

    run = "document.getElementById('value-0').textContent"
    click("getElementById('axis-0')")
    before = shown.run(run, figure)
    shown.press("ArrowRight")
    shown.wait_for(f"{run} !== {json.dumps(before)}", 10, figure)
    said = "document.getElementById('said').textContent"
    click("getElementById('map')")
    chosen = shown.run(said, figure)
    shown.press("ArrowDown")
    shown.wait_for(f"{said} !== {json.dumps(chosen)}", 10, figure)
    assert int(shown.run(said, figure).split()[1]) == int(chosen.split()[1]) + 1
    click("getElementById('play')")
    moment = shown.run(said, figure)
    shown.wait_for(f"{said} !== {json.dumps(moment)}", 10, figure)
    click("getElementById('play')")
    assert shown.run("document.getElementById('play').textContent", figure) == "Play"


@pytest.mark.parametrize(
    "executed",
    [pytest.param(False, marks=pytest.mark.slow), pytest.param(True, marks=pytest.mark.soak)],
)
def test_the_pages_build_without_a_warning(tmp_path: Path, executed: bool):
    """The tutorial and the gallery are executed by other tests, and as pages in the soak."""
    pytest.importorskip("sphinxarg", reason="Sphinx and its extensions come with lmpchain[docs]")
    copy = tmp_path / "docs"
    build = tmp_path / "built"
    shutil.copytree(DOCS, copy, ignore=shutil.ignore_patterns("build", "api", "measurements"))
    for name in ("analysis", "CITATION.cff", "CHANGELOG.md"):
        (tmp_path / name).symlink_to(ROOT / name)
    options = (
        []
        if executed
        else [
            "-D",
            "plot_gallery=0",
            "-D",
            "nb_execution_mode=off",
            "-D",
            "suppress_warnings=myst-nb.lexer",
        ]
    )
    done = subprocess.run(
        [sys.executable, "-m", "sphinx", "-W", "-q", *options, str(copy), str(build)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    index = (build / "searchindex.js").read_text(encoding="utf-8")
    assert index.startswith("Search.setIndex(")  # A script works from the file system.
    assert 'src="searchindex.js"' in (build / "search.html").read_text(encoding="utf-8")
    model = (build / "model.html").read_text(encoding="utf-8")
    assert model.count("<math") > 100
    assert not re.search("<script[^>]*mathjax", model, re.IGNORECASE)
    cited = [
        number
        for page in build.rglob("*.html")
        for number in re.findall(r"#equation-eq-(\d+)\"", page.read_text(encoding="utf-8"))
    ]
    assert len(cited) > 100
    assert all(f'id="equation-eq-{number}"' in model for number in set(cited))
    check_live_figures(build, tmp_path / "profile")
    for script in GALLERY if executed else ():
        page = (build / "measurements" / f"{script.stem}.html").read_text(encoding="utf-8")
        drawn = re.findall(r"^picture\w* =", script.read_text(encoding="utf-8"), re.MULTILINE)
        assert page.count("_images/sphx_glr_") >= len(drawn)
        # Messages of the build are not part of the page.
        assert "once for this machine" not in page
        assert "RuntimeWarning" not in page
    if program := installed():
        shown = subprocess.run(
            [
                program,
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                f"--user-data-dir={tmp_path / 'browser'}",
                "--virtual-time-budget=8000",
                "--dump-dom",
                f"{(build / 'search.html').as_uri()}?q=dispersion",
            ],
            capture_output=True,
            text=True,
            check=False,
            timeout=PATIENCE,
        ).stdout
        assert "plot_05_spectra.html" in shown


def test_a_native_run_passes_the_listed_files_in_this_order():
    text = (DOCS / "contributing.md").read_text(encoding="utf-8")
    section = text.split("## Follow one native run")[1].split("\n## ")[0]
    files = re.findall(r"^\d+\. `(.*)\.py`", section, re.MULTILINE)
    listed = [f"lmpchain.{file.replace('/', '.')}" for file in files]
    assert len(listed) <= 12
    assert all((ROOT / "lmpchain" / f"{file}.py").exists() for file in files)
    simulate(SHORT, "native")
    passed: dict[str, None] = {}

    def note(frame: Any, *_: object) -> None:
        passed.setdefault(frame.f_globals.get("__name__", ""))

    sys.setprofile(note)
    try:
        simulate(SHORT, "native")
    finally:
        sys.setprofile(None)
    # Compiled loops call each other without Python.
    python = [name for name in listed if ".kernels." not in name]
    assert [name for name in passed if name in python] == python
