"""Data frames with named columns, and labelled rows, taken by name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from narxcal.support.errors import DataError


def labels(values: ArrayLike) -> tuple[str, ...]:
    """Names of the columns of a table or of the entries of a pandas Series; () where none are text.

    Numbers are positions, not names: pandas gives them to a table without names.
    """
    found = getattr(values, "columns", None)
    if found is None:
        index = getattr(values, "index", ())
        found = () if callable(index) else index  # a list has a method of this name
    return tuple(map(str, found)) if any(isinstance(each, str) for each in found) else ()


def positions(found: Sequence[str], names: Sequence[str], file: str | None = None) -> list[int]:
    """Positions of `names` among the labels `found`.

    Raises `DataError` for a name that is missing, unknown or there twice.
    """
    expected = f"expected the columns {', '.join(names)}"
    for name, times in Counter(found).items():
        if name not in names:
            raise DataError(f"unknown column; {expected}", file=file, channel=name)
        if times > 1:
            raise DataError(f"the column is there {times} times", file=file, channel=name)
    for name in names:
        if name not in found:
            raise DataError(
                f"the column is missing; {expected}, found {', '.join(found)}",
                file=file,
                channel=name,
            )
    return [found.index(name) for name in names]


def by_name(values: ArrayLike, names: Sequence[str]) -> ArrayLike:
    """`values` with the last axis in the order of `names`, where both have names.

    Arrays, and models without names, take columns by position. Raises as `positions`.
    """
    found = labels(values)
    if not found or not names:
        return values
    return np.asarray(values)[..., positions(found, names)]
