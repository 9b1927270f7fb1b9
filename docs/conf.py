"""Sphinx settings; build with ``make docs``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from diffuphy import __version__

project = "diffuphy"
author = "The diffuphy authors"
release = version = __version__

extensions = ["myst_parser", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build"]

html_theme = "alabaster"
html_theme_options = {"description": "From a sentence to a physically true 3D film", "page_width": "1100px"}
html_show_sourcelink = False
