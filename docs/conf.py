"""How Sphinx builds the site: `python -m sphinx -W -b html docs FOLDER`; warnings are errors."""

from __future__ import annotations

import re
from typing import Any

from docutils.nodes import SkipNode, math, math_block
from docutils.utils.math.latex2mathml import tex2mathml

from dualarm_cli import __version__

project = "dualarm"
release = version = __version__
extensions = ["myst_parser", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
exclude_patterns = ["_build"]
copybutton_selector = ", ".join(
    f"div.highlight-{language} pre" for language in ("sh", "yaml", "python")
)
smartquotes = False  # options begin with two minus signs

html_theme = "furo"
html_title = project
html_static_path = ["site.css"]
html_css_files = ["site.css"]
html_copy_source = False
html_show_sphinx = False
html_show_copyright = False
html_math_renderer = "mathml"


MARKED = re.compile(
    r'<munderover>\s*(<mi>.</mi>)(.*?)(<mo stretchy="false">.</mo>)\s*</munderover>', re.DOTALL
)
"""A letter with a mark above and an index that docutils sets below: `\\dot J_G`."""


def mathml(node: math | math_block, *, as_block: bool) -> str:
    """Returns a formula as MathML, which browsers show without a script from elsewhere.

    Marks above letters are not called accents: without a font for mathematics, browsers draw those into the letter.
    """
    formula = str(tex2mathml(node.astext(), as_block=as_block)).replace(' accent="true"', "")
    return MARKED.sub(r"<msub><mover>\1\3</mover>\2</msub>", formula)


def inline_formula(translator: Any, node: math) -> None:
    """Writes a formula in a sentence."""
    translator.body.append(mathml(node, as_block=False))
    raise SkipNode


def block_formula(translator: Any, node: math_block) -> None:
    """Writes a formula on a line of its own."""
    translator.body.append(f"<p>{mathml(node, as_block=True)}</p>")
    raise SkipNode


def setup(app: Any) -> None:
    """Registers the renderer of formulas."""
    app.add_html_math_renderer("mathml", (inline_formula, None), (block_formula, None))
