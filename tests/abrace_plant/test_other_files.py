# SPDX-License-Identifier: Apache-2.0
"""Files as other people write them are read exactly, or refused with the words that help."""

import other_files
import pytest
from forked_matlab import matlab_files_by_forks  # noqa: F401

CASES = other_files.other_files()


@pytest.mark.parametrize("case", CASES, ids=[f"{i}-{case.name}" for i, case in enumerate(CASES)])
def test_file_of_another_writer_is_read_exactly_or_refused_with_the_right_words(case, tmp_path):
    assert other_files.outcome(case, tmp_path) == ""
