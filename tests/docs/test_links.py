# SPDX-License-Identifier: Apache-2.0
"""Links between pages lead to a page, a file or a heading that is there."""

import re

from documents import PAGES, ROOT, anchors

LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]+)?\)")


def sentences(page):
    return re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)


def test_links_lead_to_files_and_headings_that_are_there():
    wrong = []
    for page in PAGES:
        for target, anchor in LINK.findall(sentences(page)):
            if target.startswith("http"):
                continue
            path = page.parent / target if target else page
            if not path.exists() or (anchor and path.suffix == ".md" and anchor[1:] not in anchors(path)):
                wrong.append(f"{page.name}: {target}{anchor}")
    assert not wrong


def test_what_pages_and_docstrings_cite_is_in_the_references():
    texts = {page: sentences(page).partition("## References")[0] for page in PAGES}
    texts |= {path: path.read_text(encoding="utf-8") for path in (ROOT / "src").glob("*/*/**/*.py")}
    missing = {str(path.relative_to(ROOT)): not_in_the_references(text) for path, text in texts.items()}
    assert not {path: names for path, names in missing.items() if names}


def not_in_the_references(text):
    """Citations (`Moore 1981`, `McKelvey and Guerin 2012`, `Berg and Housner, 1961`) that are missing there."""
    authors = r"([A-Z][a-z-]{2,})(?:,? [A-Z][\w-]+)*(?:,? and (?:De )?[A-Z][\w-]+| et al\.)?"
    cited = re.findall(rf"\b{authors},? (?:\()?((?:19|20)\d\d)\)?(?=[);,:]| [a-z])", " ".join(plain(text).split()))
    return sorted(
        f"{author} {year}"
        for author, year in set(cited)
        if author not in NO_AUTHORS and not any(author in entry and year in entry for entry in LISTED)
    )


def plain(text):
    for letter, ascii_only in (("é", "e"), ("ö", "oe"), ("ü", "ue")):
        text = text.replace(letter, ascii_only)
    return text


LISTED = plain((ROOT / "docs/references.md").read_text(encoding="utf-8")).split("\n- ")
NO_AUTHORS = {"Centro", "Kobe", "Corralitos", "Sylmar", "Dam", "Pacoima", "Jazzy"}
"""Words before a year that are no author's."""
