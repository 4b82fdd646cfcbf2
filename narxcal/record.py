"""Records: inputs and outputs of uninterrupted recordings, as models are fitted to them.

Columns of data frames and entries of labelled rows are taken by their names.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from narxcal.support.arrays import FloatArray
from narxcal.support.errors import DataError

LARGEST = 1e100  # squares, and sums of 1e100 of them, stay below the largest float64, 1.8e308


@dataclass(frozen=True, eq=False)
class Record:
    """Inputs `u` (time, inputs) and outputs `y` (time, outputs) on one uniform grid.

    A masked output sample is NaN: it is left out of every loss and score. Inputs have to be
    complete, since a free run cannot skip a sample; `DataError` names the first bad row.
    `weight` (time,), if given, scales the loss of each sample. `inputs` and `outputs` name the
    columns; of a data frame they are its own, and of an array there may be none.
    """

    u: FloatArray
    y: FloatArray
    name: str = "record"
    weight: FloatArray | None = None
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "inputs", self.inputs or labels(self.u))
        object.__setattr__(self, "outputs", self.outputs or labels(self.y))
        object.__setattr__(self, "u", columns(self.u, self.name))
        object.__setattr__(self, "y", columns(self.y, self.name))
        if len(self.u) != len(self.y):
            raise DataError(
                f"inputs and outputs have to be of one length, found {len(self.u)} "
                f"and {len(self.y)} samples",
                file=self.name,
            )
        self._check_values()
        if self.weight is not None:
            object.__setattr__(self, "weight", self._checked_weight(self.weight))

    def __len__(self) -> int:
        return len(self.u)

    def ordered(self, inputs: Sequence[str], outputs: Sequence[str]) -> Record:
        """The record with its columns in this order; without names they are taken by position."""
        u, y = self.u, self.y
        if self.inputs and inputs:
            u = u[:, positions(self.inputs, inputs, self.name)]
        if self.outputs and outputs:
            y = y[:, positions(self.outputs, outputs, self.name)]
        return replace(self, u=u, y=y, inputs=tuple(inputs), outputs=tuple(outputs))

    def _check_values(self) -> None:
        bad = np.flatnonzero(~np.isfinite(self.u).all(axis=1))
        if len(bad):
            raise DataError(
                "an input is not a finite number",
                file=self.name,
                row=int(bad[0]),
                hint="Fill or cut the record first; only outputs may be masked with NaN",
            )
        infinite = np.flatnonzero(np.isinf(self.y).any(axis=1))
        if len(infinite):
            raise DataError(
                "an output is infinite",
                file=self.name,
                row=int(infinite[0]),
                hint="Mask unknown samples with NaN",
            )

        both = np.abs(np.concatenate([self.u, self.y], axis=1))
        size = np.nanmax(both, axis=1, initial=0.0)
        large = np.flatnonzero(size > LARGEST)
        if len(large):
            raise DataError(
                f"a value is beyond {LARGEST:g}, so that its square is not a finite number",
                file=self.name,
                row=int(large[0]),
                hint="Scale the channel, or mask what is no measurement",
            )

    def _checked_weight(self, given: ArrayLike) -> FloatArray:
        weight = _numbers(given, self.name)
        if weight.shape != (len(self.u),):
            raise DataError(
                f"the weight has to be of shape ({len(self.u)},), found {weight.shape}",
                file=self.name,
            )
        bad = np.flatnonzero(~(np.isfinite(weight) & (weight >= 0.0)))
        if len(bad):
            raise DataError(
                f"expected a weight of at least 0, found {weight[bad[0]]:g}",
                file=self.name,
                row=int(bad[0]),
                hint="0 leaves a sample out",
            )
        return weight


def columns(values: ArrayLike, name: str | None = None) -> FloatArray:
    """`values` as float64 (time, channels); of one dimension they are one channel over time.

    What a masked array hides is NaN. Raises `DataError` for anything but real numbers, and for
    more than two dimensions.
    """
    array = _numbers(values, name)
    if array.ndim > 2:
        raise DataError(
            f"expected (time, channels), found an array of shape {array.shape}",
            file=name,
            hint="Pass a batch as a list of records",
        )
    return array[:, None] if array.ndim == 1 else array


def _numbers(values: ArrayLike, name: str | None) -> FloatArray:
    # NumPy itself would drop a mask without a word, and an imaginary part with a mere warning.
    if isinstance(values, np.ma.MaskedArray):
        values = np.ma.filled(values.astype(np.float64), np.nan)
    if np.iscomplexobj(values):
        raise DataError("expected an array of real numbers, found complex ones", file=name)
    try:
        return np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise DataError(
            f"expected an array of real numbers, found {type(values).__name__} ({error})", file=name
        ) from None


Pair: TypeAlias = tuple[ArrayLike, ArrayLike]
RecordLike: TypeAlias = Record | Pair


def as_records(
    given: RecordLike | Iterable[RecordLike],
    name: str = "record",
    like: tuple[Sequence[str], Sequence[str]] = ((), ()),
) -> list[Record]:
    """Records as users have them: `Record`, pairs (u, y), one of these or several.

    A pair is called `name` and its number. Named columns are put in the order of `like`, input and
    output names, or of the first record that has names. Raises `DataError` for anything else, and
    as `Record` and `Record.ordered` do.
    """
    if isinstance(given, Record) or _is_pair(given):
        given = [given]
    # One array, table or tensor can be iterated over, too, but what comes of it is no record.
    if hasattr(given, "__array__") or not isinstance(given, Iterable):
        raise _no_record(given)
    records = [_as_record(each, f"{name} {number}") for number, each in enumerate(given, 1)]
    inputs = like[0] or next((one.inputs for one in records if one.inputs), ())
    outputs = like[1] or next((one.outputs for one in records if one.outputs), ())
    return [one.ordered(inputs, outputs) for one in records]


def _is_pair(given: object) -> TypeGuard[Pair]:
    """Whether this is (u, y), and not two records in a tuple."""
    return isinstance(given, tuple) and len(given) == 2 and not isinstance(given[0], tuple | Record)


def _as_record(given: object, name: str) -> Record:
    if isinstance(given, Record):
        return given
    if not _is_pair(given):
        raise _no_record(given)
    u, y = given
    names = labels(u), labels(y)
    return Record(columns(u, name), columns(y, name), name, None, *names)


def _no_record(given: object) -> DataError:
    shape = f" of shape {tuple(given.shape)}" if hasattr(given, "shape") else ""
    return DataError(
        f"expected records of inputs and outputs, found {type(given).__name__}{shape}",
        hint="Pass a list of pairs, [(u, y)], or of Record(u, y)",
    )


def known_start(y: FloatArray, samples: int) -> FloatArray:
    """First `samples` outputs; a masked one takes its channel's first known value."""
    first = y[np.isfinite(y).argmax(axis=0), np.arange(y.shape[1])]
    return np.where(np.isfinite(y[:samples]), y[:samples], np.nan_to_num(first))


def check_measured(records: Sequence[Record], purpose: str) -> None:
    """Raise `DataError` for an output that is masked throughout: nothing can be learnt of it."""
    known = np.any([np.isfinite(record.y).any(axis=0) for record in records], axis=0)
    if not known.all():
        raise DataError(
            f"output {int(np.argmin(known)) + 1} of {len(known)} has no known sample in any "
            f"{purpose} record",
            file=records[0].name,
            hint="Leave the output out, or add records that hold it",
        )


def check_records(records: Sequence[Record], longer_than: int) -> tuple[int, int]:
    """Return (inputs, outputs) that all records agree on; `DataError` where they do not."""
    if not records:
        raise DataError("at least one record is needed, found none")
    inputs, outputs = records[0].u.shape[1], records[0].y.shape[1]
    if not (inputs and outputs):
        raise DataError(
            f"expected an input and an output at least, found {inputs} and {outputs}",
            file=records[0].name,
            hint="Give arrays of shape (time, channels)",
        )
    for record in records:
        found = (record.u.shape[1], record.y.shape[1])
        if found != (inputs, outputs):
            raise DataError(
                f"expected {inputs} inputs and {outputs} outputs as in {records[0].name}, "
                f"found {found[0]} and {found[1]}",
                file=record.name,
            )
        if len(record) <= longer_than:
            raise DataError(
                f"a record needs more than {longer_than} samples, found {len(record)}",
                file=record.name,
                hint="Leave this record out, or join it to the one that it was cut from",
            )
    return inputs, outputs


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
    """Positions of `names` among the labels `found`."""
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
