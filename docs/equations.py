"""Equations, numbers and names on the pages: how they are typeset, and how equations are cited.

Mathematics becomes MathML, which browsers draw without a script. Wherever a page or a docstring
cites an equation of the paper by its number, "Eq. (3)", the number leads to the page "Model and
equations", which writes it out. A number as 1e-6 stays on its line, which a browser would end
behind the sign; a long name in a table may end a line behind its dots, so that it leaves room for
what is said of it.
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
DECIMAL = re.compile(r"[-−]?\d+(?:\.\d+)?e-\d+")
JOINT = re.compile(r"(?<=[./_:,])(?=\w)")
# an upright letter with an exponent or index, which latex2mathml would set in italics
UPRIGHT = re.compile(r"\\mathrm(?: ([A-Za-z])|\{([A-Za-z])\})(?=\s*[\^_])")
# code, formulas and headings stay as they are
PLAIN = (nodes.literal, nodes.literal_block, nodes.math, nodes.math_block, nodes.title, nodes.raw)


def typeset(formula: str, display: str = "inline") -> str:
    """Return the MathML of a formula in LaTeX."""
    return convert(UPRIGHT.sub(r"\\text{\1\2}", formula), display=display)


def write_inline(writer: HTML5Translator, node: nodes.math) -> None:
    """Write a formula within a line."""
    writer.body.append(typeset(node.astext()))
    raise nodes.SkipNode


def write_block(writer: HTML5Translator, node: nodes.math_block) -> None:
    """Write a formula on lines of its own, with the number that the paper gives it."""
    label = node.get("label") or ""
    writer.body.append(writer.starttag(node, "div", CLASS="equation"))
    writer.body.append(typeset(node.astext(), "block"))
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
        # a link within a link is none
        if CITED.search(text) and not within(text, (*PLAIN, nodes.reference)):
            text.parent.replace(text, linked(str(text), target))


def keep_decimals(app: Sphinx, document: nodes.document, page: str) -> None:
    """Let numbers with an exponent of ten stay on their lines."""
    if app.builder.format != "html":
        return
    for text in list(document.findall(nodes.Text)):
        if DECIMAL.search(text) and not within(text, PLAIN):
            text.parent.replace(text, kept(str(text)))


def break_names(app: Sphinx, document: nodes.document, page: str) -> None:
    """Let lines end within the names of files, modules and functions in tables and titles."""
    if app.builder.format != "html":
        return
    names = [name for name in document.findall(nodes.literal) if within(name, (nodes.entry,))]
    titles = [title for title in document.findall(nodes.title) if " " not in title.astext()]
    for name in names + titles:
        if JOINT.search(name.astext()):
            first, *others = JOINT.split(name.astext())
            name[:] = [nodes.Text(first)]
            for piece in others:
                name += [nodes.raw("", "<wbr>", format="html"), nodes.Text(piece)]


def within(node: nodes.Node, kinds: tuple[type[nodes.Node], ...]) -> bool:
    """Say whether a node stands in one of these kinds."""
    enclosing = node.parent
    while enclosing is not None and not isinstance(enclosing, kinds):
        enclosing = enclosing.parent
    return enclosing is not None


def kept(text: str) -> list[nodes.Node]:
    """Return a text as nodes, in which its numbers with an exponent are not broken."""
    pieces: list[nodes.Node] = []
    start = 0
    for number in DECIMAL.finditer(text):
        pieces.append(nodes.Text(text[start : number.start()]))
        pieces.append(nodes.inline("", number[0], classes=["decimal"]))
        start = number.end()
    pieces.append(nodes.Text(text[start:]))
    return pieces


def trim_code(app: Sphinx, document: nodes.document) -> None:
    """Take away the empty line that ends an example in Python, for doctest."""
    for block in document.findall(nodes.literal_block):
        code = block.astext()
        # Sphinx colours code whose source is its text
        if code.endswith("\n") and block.rawsource == code:
            block.rawsource = code.rstrip("\n")
            block[:] = [nodes.Text(block.rawsource)]


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
    app.connect("doctree-read", trim_code)
    app.connect("doctree-resolved", link_equations)
    app.connect("doctree-resolved", keep_decimals)
    app.connect("doctree-resolved", break_names)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
