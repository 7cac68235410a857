# SPDX-License-Identifier: Apache-2.0
"""Links between pages lead to a page, a file or a heading that is there."""

import re

import pytest
from documents import GENERATED, PAGES, ROOT, anchors

LINK = re.compile(r"\]\(([^)#\s]*)(#[^)\s]+)?\)")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_to_files_and_headings_that_are_there(page):
    wrong = []
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    for target, anchor in LINK.findall(text):
        if target.startswith("http"):
            continue
        path = page.parent / target if target else page
        if not path.exists() or (anchor and path.suffix == ".md" and anchor[1:] not in anchors(path)):
            wrong.append(target + anchor)
    assert not wrong, f"{page.name}: {wrong}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_is_cited_is_in_the_references(page):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL).partition("## References")[0]
    missing = not_in_the_references(text)
    assert not missing, f"{page.name}: {missing} not in docs/references.md"


def test_what_docstrings_cite_is_in_the_references():
    modules = sorted((ROOT / "src").glob("*/*/**/*.py"))
    missing = {str(path.relative_to(ROOT)): not_in_the_references(path.read_text(encoding="utf-8")) for path in modules}
    assert not {path: names for path, names in missing.items() if names}


def test_a_citation_that_is_not_in_the_references_is_found():
    assert not not_in_the_references("as in (Moore 1981), by Doehler and Mevel (2013); Berg and Housner, 1961, too")
    assert not_in_the_references("(Moore 1982)") == ["Moore 1982"]


def not_in_the_references(text):
    """Citations (`Moore 1981`, `McKelvey and Guerin 2012`, `Berg and Housner, 1961`) that are missing there."""
    listed = plain((ROOT / "docs/references.md").read_text(encoding="utf-8")).split("\n- ")
    authors = r"([A-Z][a-z-]{2,})(?:,? [A-Z][\w-]+)*(?:,? and (?:De )?[A-Z][\w-]+| et al\.)?"
    cited = re.findall(rf"\b{authors},? (?:\()?((?:19|20)\d\d)\)?(?=[);,:]| [a-z])", " ".join(plain(text).split()))
    return sorted(
        f"{author} {year}"
        for author, year in set(cited)
        if author not in NO_AUTHORS and not any(author in entry and year in entry for entry in listed)
    )


def plain(text):
    for letter, ascii_only in (("é", "e"), ("ö", "oe"), ("ü", "ue")):
        text = text.replace(letter, ascii_only)
    return text


def test_pages_with_equations_of_the_paper_say_which_paper_and_what_its_symbols_are():
    pages = [page for page in (ROOT / "docs").glob("*.md") if page.stem not in (*GENERATED, "glossary", "references")]
    sentences = {page: re.sub(r"```.*?```", "", page.read_text(), flags=re.DOTALL) for page in pages}
    with_equations = [page for page, text in sentences.items() if re.search(r"Eqs?\. \(", text)]
    assert len(with_equations) > 5
    for page in with_equations:
        assert "references.md#the-paper" in sentences[page], page.name


NO_AUTHORS = {"Centro", "Kobe", "Corralitos", "Sylmar", "Dam", "Pacoima", "Jazzy"}
"""Words before a year that are no author's."""
