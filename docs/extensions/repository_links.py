"""Links between the repository's Markdown files, as the site has them.

The same files are read in the repository, where a link is a path that may lead to any file. The
site has the pages of ``docs`` and, by symbolic links there, the experiments and some files of the
top level. So each link is followed in the repository and written as the site's own: to a page, or
else to the file as a download.
"""

import os
import re
from pathlib import Path

from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parent.parent
LINK = re.compile(r"(?<!!)\[(?P<text>[^\]]*)\]\((?P<path>[^)#\s:]+)(?P<anchor>#[^)\s]*)?\)")


def site_pages() -> dict[Path, Path]:
    """The site's pages, relative to ``docs``, by the files that they really are."""
    return {
        Path(folder, name).resolve(): Path(folder, name).relative_to(DOCS)
        for folder, _, names in os.walk(DOCS, followlinks=True)
        for name in names
        if name.endswith(".md")
    }


def rewrite_links(app: Sphinx, docname: str, content: list[str]) -> None:
    """Rewrites the links of one page before it is parsed."""
    folder = Path(app.env.doc2path(docname)).resolve().parent
    pages = site_pages()

    def rewrite(link: re.Match[str]) -> str:
        target = (folder / link["path"]).resolve()
        if target.is_dir():
            target = target / "README.md"
        if target in pages:
            page = pages[target]
            if target.is_relative_to(DOCS):
                return f"[{link['text']}](/{page}{link['anchor'] or ''})"
            # MyST follows symbolic links, out of the site; the role does not.
            return f"{{doc}}`{link['text']} </{page.with_suffix('')}>`"
        if target.is_file():
            return f"{{download}}`{link['text']} </{os.path.relpath(target, DOCS)}>`"
        return link[0]

    content[0] = LINK.sub(rewrite, content[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Called by Sphinx."""
    app.connect("source-read", rewrite_links)
    return {"parallel_read_safe": True}
