"""The documentation site: `make docs` builds it into out/site, without a network; every warning is an error."""

from __future__ import annotations

import sys
from importlib.metadata import version as version_of
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

HERE = Path(__file__).parent
ROOT = HERE.parent
sys.path[:0] = [str(HERE / "extensions"), str(ROOT), str(ROOT / "factors")]

project = "fgpose"
author = "The fgpose authors"
version = release = version_of("fgpose")
language = "en-GB"

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "columns",
    "command_help",
    "configuration",
    "mathml",
    "plain_docstrings",
]
exclude_patterns = ["pictures/README.md"]

myst_enable_extensions = ["colon_fence", "deflist", "dollarmath", "attrs_inline"]
# Links to headings work as on the pages of a forge, and a link to a heading that is not there is a warning.
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
autodoc_default_options = {"members": True, "undoc-members": True}
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
maximum_signature_line_length = 90
add_module_names = False
toc_object_entries_show_parents = "hide"

html_theme = "furo"
html_title = f"fgpose {release}"
html_static_path = ["_static"]
html_css_files = ["fgpose.css"]
html_math_renderer = "mathml"
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072b2", "color-brand-content": "#0072b2"},
    "dark_css_variables": {"color-brand-primary": "#56b4e9", "color-brand-content": "#56b4e9"},
}
copybutton_exclude = ".linenos, .gp, .go"

# Files outside docs/ are included as they are. Their links lead from where they lie to what is on the site.
_LINKS = {
    "](docs/": "](../",
    "](../docs/": "](../",
    "](calibration/report.md": "](calibration.md",
    "](calibration/ablation.md": "](calibration_ablation.md",
}


def _relink(_: Sphinx, relative_path: Path, parent: str, content: list[str]) -> None:
    for link, on_site in _LINKS.items():
        content[0] = content[0].replace(link, on_site)


def setup(app: Sphinx) -> None:
    app.connect("include-read", _relink)
