"""Templates: rendering, rejected templates, tables, names and modules."""

import hashlib
import os
import platform
import re
import subprocess
import sys
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.faults import faults

from lmpchain import InputError
from lmpchain.errors import did_you_mean, not_among
from lmpchain.util import provenance
from lmpchain.util.lazy import attributes, listed
from lmpchain.util.tables import number
from lmpchain.util.templates import render, render_text


def fault(text: str, **values: Any) -> str:
    ((key, message),) = faults(render_text, text, "template", **values)
    assert key == "template"
    return message


def test_values_are_rendered_with_all_digits():
    third = np.float64(1 / 3)
    assert render_text("{{ x|exact }} {{ n }}\n", "template", x=third, n=2) == f"{1 / 3!r} 2\n"
    assert render_text("{{ version }}", "template") == version("lmpchain")
    assert render_text("<{{ x }}>", "template", x="<&") == "<<&>"


def test_tags_leave_no_empty_lines():
    text = "a\n  {% for n in range(2) %}\n  {{ n }}\n  {% endfor %}\nb\n\n"
    assert render_text(text, "template") == "a\n  0\n  1\nb\n\n"
    macro = "{% macro twice(x) %}{{ 2 * x }}{% endmacro %}{{ twice(3) }}"
    assert render_text(macro, "template") == "6"


def test_errors_of_a_template_name_its_values():
    message = fault("{{ b }} {{ c }}", b=1, a=2)
    assert message == "there is no placeholder 'c'; there are a, b, version"
    assert [each for _, each in faults(render_text, "{{ z }} {{ c }}", "template")] == [
        f"there is no placeholder {name!r}; there are version" for name in "cz"
    ]
    assert fault("a\n{% if %}").startswith("line 2 is not valid Jinja2: ")
    message = fault('{% include "nowhere" %}')
    assert message.startswith("cannot include 'nowhere'; there are ")
    assert "in.column" in message
    assert fault("{{ 1 / 0 }}") == "cannot be filled in: division by zero"


@pytest.mark.parametrize(
    "text",
    [
        '{{ "a" * 10**10 }}',
        '{{ "a" * 10000000000 }}',
        '{{ "%10000000000d" % 1 }}',
        '{{ "a" | center(10000000000) }}',
        "{{ [0] * 10000000000 }}",
        '{{ ("a" * 1000) | replace("a", "a" * 1000) | replace("a", "a" * 1000) }}',
        '{% for i in range(100000) %}{{ "b" * 100000 }}{% endfor %}',
    ],
)
def test_a_template_has_a_memory_limit(text):
    assert fault(text) == "needs more than 256 MB of memory: make its texts and lists shorter"


def test_a_power_in_a_template_is_a_float():
    assert render_text("{{ 2**10 }} {{ 2**-1 }} {{ 10**99 }}", "template") == "1024 0.5 1e+99"
    assert fault("{{ 10**999 }}").startswith("cannot be filled in: ")


class Secret:
    word = "swordfish"


def test_a_template_can_only_read_its_values():
    closed = "uses something that templates cannot access"
    named = SimpleNamespace(word="open")
    assert render_text("{{ value.word }}", "template", value=named) == "open"
    assert render_text("{{ value.word }}", "template", value=Secret()) == "swordfish"
    with pytest.raises(InputError, match="template: "):
        render_text("{{ value.word }}", "template", (Secret,), value=Secret())
    for text in ("{{ value.__class__.__name__ }}", "{{ value.word.upper() }}", "{{ value() }}"):
        message = fault(text, value=Secret())
        assert message.startswith((closed, "cannot be filled in"))
    assert fault("{{ value() }}", value=print).startswith(closed)


def test_a_page_of_the_package_escapes_and_a_deck_does_not():
    with pytest.raises(Exception, match="undefined"):
        render("report.html")
    still = SimpleNamespace(caption="<b>", alt="a", svg="")
    lists = ("cards", "sections", "fits", "notes", "left_out", "facts", "provenance")
    texts = ("scene", "script", "digest", "citation")
    values = {key: [] for key in lists} | dict.fromkeys(texts, "")
    page = render("report.html", title="<i>", still=still, live={}, **values)
    assert "&lt;i&gt;" in page
    assert "<i>" not in page
    assert version("lmpchain") in page


# --- names


def test_misspelt_names():
    known = ["glass", "steel", "PTFE"]
    for name, meant in (("glas", "glass"), ("STEEL", "steel"), ("ptf", "PTFE"), ("stel", "steel")):
        assert did_you_mean(name, known) == f" (did you mean {meant!r}?)"
    for name in ("wood", 5, None, ""):
        assert did_you_mean(name, known) == ""
    assert not_among(5, iter(known)) == "must be glass | steel | PTFE (got 5)"
    assert not_among("glas", iter(known)).endswith("(got 'glas') (did you mean 'glass'?)")


def test_names_of_a_package_are_imported_on_use(monkeypatch: pytest.MonkeyPatch):
    package = ModuleType("lmpchain.made_up")
    monkeypatch.setitem(sys.modules, package.__name__, package)
    find = attributes(
        "lmpchain", ["theory"], {"util.tables": "aligned number", "errors": "InputError"}
    )
    assert find("theory").__name__ == "lmpchain.theory"
    import lmpchain

    vars(lmpchain).pop("number", None)
    monkeypatch.setattr(lmpchain, "number", None, raising=False)
    assert find("number") is number
    assert vars(lmpchain)["number"] is number, "found at once from now on"
    with pytest.raises(AttributeError, match="module 'lmpchain' has no attribute 'other'"):
        find("other")
    with pytest.raises(AttributeError):
        attributes("lmpchain")("aligned")


def test_a_module_lists_its_own_functions_and_classes(monkeypatch: pytest.MonkeyPatch):
    module = ModuleType("made_up")
    exec(
        "def work(): pass\ndef _hidden(): pass\nclass Kind: pass\nnumber = 5\nfrom math import sin",
        vars(module),
    )
    for name in ("work", "_hidden", "Kind"):
        vars(module)[name].__module__ = "made_up"
    monkeypatch.setitem(sys.modules, "made_up", module)
    assert listed("made_up")() == ["Kind", "work"]
    vars(module)["__all__"] = ["work", "number"]
    assert listed("made_up")() == ["number", "work"]


# --- provenance


def test_checksums_agree_with_sha256sum(tmp_path: Path):
    (tmp_path / "inner").mkdir()
    for name, content in {"b": b"2", "a": b"1", "inner/c": b"3"}.items():
        (tmp_path / name).write_bytes(content)
    lines = provenance.checksums(tmp_path, [tmp_path / name for name in ("a", "b", "inner/c")])
    assert re.findall(r"  (.*)\n", lines) == ["a", "b", "inner/c"]
    assert lines.startswith(f"{hashlib.sha256(b'1').hexdigest()}  a\n")
    done = subprocess.run(
        ["sha256sum", "--check"], input=lines, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0


def test_a_command_is_stored_up_to_2000_letters(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(sys, "argv", ["lmpchain", "run", "a scene.toml"])
    assert provenance.command() == "lmpchain run 'a scene.toml'"
    for letters, whole in ((2000, True), (2001, False)):
        monkeypatch.setattr(sys, "argv", ["x" * letters])
        assert provenance.command() == ("x" * letters if whole else "x" * 2000 + " ...")


def test_a_session_describes_host_and_command():
    before = datetime.now(UTC).replace(microsecond=0)
    session = provenance.describe_session()
    assert before <= datetime.fromisoformat(session["began"]) <= datetime.now(UTC)
    assert session["began"].endswith("+00:00")
    assert len(session["began"]) == len("2024-05-06T07:08:09+00:00")
    assert session["packages"]["numpy"] == np.__version__ == provenance.versions()["numpy"]
    assert (
        session["packages"]["lmpchain"] == version("lmpchain") == provenance.versions()["lmpchain"]
    )
    assert (session["cores"], session["host"]) == (os.cpu_count(), platform.node())
    assert session["command"] == provenance.command()
    assert session["working_folder"] == os.getcwd()


def test_a_processor_is_named_or_its_kind(monkeypatch: pytest.MonkeyPatch):
    text = "processor\t: 0\nmodel\t: 7\nmodel name\t: Fast: One\nmodel name\t: Two\n"
    monkeypatch.setattr(Path, "read_text", lambda self, **_: text)
    assert provenance.processor() == "Fast: One"
    monkeypatch.setattr(Path, "read_text", lambda self, **_: "processor: 0")
    assert provenance.processor() == platform.machine()
