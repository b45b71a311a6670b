"""How Sphinx builds the site: `python -m sphinx -W -b html docs FOLDER`; warnings are errors."""

from dualarm_cli import __version__

project = "dualarm"
release = version = __version__
extensions = ["myst_parser"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
exclude_patterns = ["_build"]

html_theme = "furo"
html_title = f"dualarm {__version__}"
html_copy_source = False
html_show_sphinx = False
