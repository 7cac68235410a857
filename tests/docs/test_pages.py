# SPDX-License-Identifier: Apache-2.0
"""Every page is followed: its blocks run in their order, in a folder that holds the results of the demo.

What is not run is listed with its reason in `page_runner.NOT_HERE` and `SKIP`, what is not compared in `ELSEWHERE`.
"""

from pathlib import Path

import pytest
from documents import PAGES
from page_runner import SKIP, copied, follow, is_followed


@pytest.mark.usefixtures("domain")
@pytest.mark.parametrize("page", list(filter(is_followed, PAGES)), ids=lambda page: page.stem)
def test_a_page_can_be_followed(page: Path, made_demo: Path, tmp_path: Path) -> None:
    followed = follow(page, copied(made_demo, tmp_path / "laboratory"), SKIP.get(page.stem))
    assert not followed.wrong, "\n".join([f"{page.name} shows what is not printed:", *followed.wrong])
