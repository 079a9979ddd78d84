"""Equations on the pages: typeset when they are built, and cited by links.

Mathematics becomes MathML, which browsers draw without a script. Wherever a page or a docstring
cites an equation of the paper by its number, "Eq. (3)", the number leads to the page "Model and
equations", which writes it out.
"""

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

PAGE = "model"
CITED = re.compile(r"Eqs?\.\s\(\d+\)(?:(?:,|,? and| to|, or| or)\s\(\d+\))*")
NUMBER = re.compile(r"\((\d+)\)")
# a link within a link is none; code and headings stay as they are
PLAIN = (nodes.literal, nodes.literal_block, nodes.reference, nodes.title, nodes.raw)


def write_inline(writer: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def write_block(writer: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on lines of its own, with the number that the paper gives it."""
    label = node.get("label") or ""
    writer.body.append(writer.starttag(node, "div", CLASS="equation"))
    writer.body.append(convert(node.astext(), display="block"))
    if label.startswith("eq-"):
        writer.body.append(f'<span class="number">({label.removeprefix("eq-")})</span>')
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def link_equations(app: Sphinx, document: nodes.document, page: str) -> None:
    """Let the numbers of equations in a text lead to the equations."""
    if app.builder.format != "html":
        return
    target = "" if page == PAGE else app.builder.get_relative_uri(page, PAGE)
    for text in list(document.findall(nodes.Text)):
        enclosing = text.parent
        while enclosing is not None and not isinstance(enclosing, PLAIN):
            enclosing = enclosing.parent
        if enclosing is None and CITED.search(text):
            text.parent.replace(text, list(linked(str(text), target)))


def linked(text: str, target: str) -> list[nodes.Node]:
    """Return a text as nodes, those of its numbers of equations that are cited being links."""
    pieces: list[nodes.Node] = []
    start = 0
    for citation in CITED.finditer(text):
        for number in NUMBER.finditer(text, *citation.span()):
            pieces.append(nodes.Text(text[start : number.start()]))
            address = f"{target}#equation-eq-{number[1]}"
            pieces.append(nodes.reference("", number[0], internal=True, refuri=address))
            start = number.end()
    pieces.append(nodes.Text(text[start:]))
    return pieces


def setup(app: Sphinx) -> dict[str, Any]:
    """Tell Sphinx how mathematics is written, and what is done with a page before it is."""
    app.add_html_math_renderer("mathml", (write_inline, None), (write_block, None))
    app.connect("doctree-resolved", link_equations)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
