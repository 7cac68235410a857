# SPDX-License-Identifier: Apache-2.0
"""Numbers as a pandas table, for those who have pandas."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from abrace_core.errors import AbraceError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    import pandas
    from numpy.typing import NDArray


def data_frame(
    columns: Mapping[str, Sequence[Any] | NDArray[Any]], index_name: str, index: Sequence[Any] | NDArray[Any]
) -> pandas.DataFrame:
    """A table.

    Parameters
    ----------
    columns
        By name: (rows,) each.
    index_name, index
        What the rows are, and (rows,) their names or places.

    Raises
    ------
    AbraceError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError as error:
        raise AbraceError("pandas is not installed, expected the package pandas (pip)") from error
    return pandas.DataFrame(dict(columns), index=pandas.Index(index, name=index_name))
