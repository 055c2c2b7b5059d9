"""The site's configuration: ``make docs`` builds it into ``build/docs``."""

import sys
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.util.inspect import signature as signature_of
from sphinx.util.inspect import stringify_signature

sys.path.insert(0, str(Path(__file__).parent / "extensions"))

import fbrl

project = "fbrl"
author = "the fbrl maintainers"
copyright = "the fbrl maintainers. Densities: data of StatsBomb"
version = release = fbrl.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
    "repository_links",
]
exclude_patterns = ["**/.*"]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"fbrl {version}"
html_copy_source = False
html_show_sphinx = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#1b6e3c", "color-brand-content": "#1b6e3c"},
    "dark_css_variables": {"color-brand-primary": "#6fcf97", "color-brand-content": "#6fcf97"},
}
copybutton_prompt_text = "$ "


def keep_colons(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Keeps napoleon from taking "What is maximised: goals" for a type and its description."""
    if what in ("attribute", "data", "property"):
        lines[:0] = ["..", ""]  # a comment, so that the first line has no colon


def show_constructor(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, signature: str, returns: str
) -> tuple[str, None] | None:
    """Tensordict's modules hide the signature of ``__init__`` behind that of ``__new__``."""
    if what != "class" or signature != "(*args, **kwargs)":
        return None
    constructor = signature_of(obj.__init__, bound_method=True)
    return stringify_signature(constructor, show_annotation=False), None


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-signature", show_constructor)
    app.connect("autodoc-process-docstring", keep_colons, priority=400)  # napoleon's is 500
