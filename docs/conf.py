"""The documentation as a site: `make site` writes it to build/site, strictly."""

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

sys.path.insert(0, str(Path(__file__).parent.parent))

from designlab import __version__

project = "designlab"
author = "the designlab authors"
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
exclude_patterns = ["records", "_static", "images"]
html_theme = "furo"
html_title = f"designlab {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_js_files = ["filter.js"]
html_show_copyright = False
html_math_renderer = "mathml"
myst_heading_anchors = 4  # GitHub's anchors, which the pages link with
myst_enable_extensions = ["dollarmath"]
numpydoc_show_class_members = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give types and units


def _math(writer: Any, node: nodes.Element) -> None:
    """Write a formula as MathML, which browsers draw without a program from elsewhere."""
    block = isinstance(node, nodes.math_block)
    writer.body.append(tex2mathml(node.astext(), as_block=block))
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Register how formulas are written."""
    app.add_html_math_renderer("mathml", (_math, None), (_math, None))
