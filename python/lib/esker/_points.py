"""Points of an answer as numpy arrays."""

import json
import threading
from fractions import Fraction
from typing import Any, Dict, Iterator, Optional, Tuple

import numpy as np

from . import _esker


def counted(n: int, what: str) -> str:
    """``1 point``, ``2,000 points``."""
    return f"{n:,} {what}{'' if n == 1 else 's'}"


class Points:
    """Some points, as one structured array or as one array for each of their attributes.

    Both forms have the same fields: ``x``, ``y``, ``z`` (float64, world coordinates) or ``X``, ``Y``, ``Z`` (int64,
    lattice steps, with ``positions="lattice"``); ``scan`` with ``with_scan=True``; then the attributes by their LAS
    dimension names. The form that is asked for first is made from the decoded points in one copy, on all threads; the
    other one is made from the first when it is needed.
    """

    def __init__(self, decoded: "_esker.Points", masked: bool) -> None:
        self._decoded = decoded
        self._fields = decoded.fields()
        self._len = len(decoded)
        self._masked = masked
        self._lock = threading.Lock()
        self._points: Optional[np.ndarray] = None
        self._columns: Optional[Dict[str, np.ndarray]] = None
        self._nulls: Optional[Dict[str, np.ndarray]] = None

    def __len__(self) -> int:
        return self._len

    @property
    def dtype(self) -> np.dtype:
        """The type of :attr:`points`: packed, in the machine's byte order."""
        return np.dtype([(name, kind) for name, kind, _ in self._fields])

    @property
    def names(self) -> Tuple[str, ...]:
        """The names of all fields."""
        return tuple(name for name, _, _ in self._fields)

    @property
    def nullable(self) -> Tuple[str, ...]:
        """Attributes that are null for some points, or may be: a scan of the answer lacks them, or they have a no-data
        value.

        A plain array has 0 where a scan lacks the attribute and the no-data value as it was stored; ``masked=True``
        tells such values apart.
        """
        return tuple(name for name, _, nullable in self._fields if nullable)

    @property
    def points(self) -> np.ndarray:
        """A structured array; a masked one with ``masked=True``."""
        with self._lock:
            if self._points is None:
                points: Any = np.empty(self._len, self.dtype)
                if self._columns is None:
                    self._decoded.fill(points.view(np.uint8))
                    self._done_with_decoded()
                else:
                    for name, column in self._columns.items():
                        points[name] = np.ma.getdata(column)
                if self._nulls is not None:
                    mask = np.zeros(self._len, np.ma.make_mask_descr(self.dtype))
                    for name, nulls in self._nulls.items():
                        mask[name] = nulls
                    points = np.ma.MaskedArray(points, mask=mask)
                self._points = points
            return self._points

    @property
    def columns(self) -> Dict[str, np.ndarray]:
        """An array for each field, by name; masked ones where there may be nulls, with ``masked=True``."""
        with self._lock:
            if self._columns is None:
                if self._points is None:
                    arrays = self._decoded.columns()
                    self._done_with_decoded()
                else:
                    data = np.ma.getdata(self._points)
                    arrays = [np.ascontiguousarray(data[name]) for name in self.names]
                columns = dict(zip(self.names, arrays))
                for name, nulls in (self._nulls or {}).items():
                    columns[name] = np.ma.MaskedArray(columns[name], mask=nulls)
                self._columns = columns
            return self._columns

    @property
    def xyz(self) -> np.ndarray:
        """Positions as an array of n rows and 3 columns: a copy."""
        names = self.names[:3]
        with self._lock:
            made = self._points
        if made is not None:
            return np.stack([np.ma.getdata(made)[name] for name in names], axis=1)
        columns = self.columns
        return np.stack([columns[name] for name in names], axis=1)

    def __getitem__(self, name: str) -> np.ndarray:
        """The array of an attribute, looked up as in a filter: ``intensity`` and ``return_number`` will do."""
        if not isinstance(name, str):
            raise TypeError("a name of an attribute is needed; .points has the points by number")
        names = list(self.names)
        found = _esker.same_attribute(name, names)
        if found is None:
            raise KeyError(name)
        return self.columns[names[found]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and _esker.same_attribute(name, list(self.names)) is not None

    def __array__(self, dtype: Any = None, copy: Optional[bool] = None) -> np.ndarray:
        """:attr:`points`, for numpy's functions."""
        array = np.asarray(self.points, dtype)
        return array.copy() if copy else array

    def __getstate__(self) -> Dict[str, Any]:
        """Pickled, points are their arrays."""
        self.points
        return {name: value for name, value in vars(self).items() if name not in ("_lock", "_decoded")}

    def __setstate__(self, state: Dict[str, Any]) -> None:
        vars(self).update(state)
        self._lock = threading.Lock()

    def __repr__(self) -> str:
        return f"<esker.{type(self).__name__} of {counted(self._len, 'point')}: {', '.join(self.names)}>"

    def _done_with_decoded(self) -> None:
        if self._masked:
            nulls = zip(self.names, self._decoded.nulls())
            self._nulls = {name: array for name, array in nulls if array is not None}
        self._decoded.release()


class Answer(Points):
    """All points of a query, and how good they are."""

    def __init__(self, decoded: "_esker.Points", masked: bool, report: str) -> None:
        super().__init__(decoded, masked)
        self._report: Dict[str, Any] = json.loads(report)

    @property
    def error_bound(self) -> Optional[float]:
        """Every matching point of the store has one of these within this distance, in units of the CRS; ``None`` if
        nothing can be promised."""
        return self._report["error_bound"]

    @property
    def error_bound_px(self) -> Optional[float]:
        """For views: the same in pixels, at the centre of the image."""
        return self._report["error_bound_px"]

    @property
    def region_misses_site(self) -> bool:
        """Does the region lie outside the bounds of all points?"""
        return self._report["region_misses_site"]

    @property
    def on_maximum_faces(self) -> Optional[int]:
        """Matching points on the maximum faces of the box, which is half-open and does not have them (``closed=True``
        takes them); ``None`` where they were not counted: they are at full detail only."""
        return self._report["on_maximum_faces"]

    @property
    def statistics(self) -> Dict[str, Any]:
        """What the answer cost, as ``statistics`` in the command line's ``query --json``: nodes and bytes read, points
        decoded, time."""
        return dict(self._report["statistics"])


class Batches:
    """The points of a query, some at a time; see :meth:`esker.Store.batches`."""

    def __init__(self, batches: "_esker.Batches", masked: bool) -> None:
        self._batches = batches
        self._masked = masked

    def __iter__(self) -> "Batches":
        return self

    def __reduce__(self) -> Any:
        raise TypeError("batches belong to their process; answers of query can be pickled, and so can a store")

    def __next__(self) -> Points:
        decoded = self._batches.take()
        if decoded is None:
            raise StopIteration
        return Points(decoded, self._masked)

    @property
    def answer(self) -> Optional[Dict[str, Any]]:
        """What the command line's ``query -o - --json`` says of the answer: points, error bound, what it cost; ``None``
        until all batches were taken."""
        report = self._batches.answer()
        return None if report is None else json.loads(report)

    def close(self) -> None:
        """Reads no more."""
        self._batches.close()

    def __enter__(self) -> "Batches":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Neighbors(Points):
    """The neighbours of some points: those of the first, nearest first, then those of the second, and so on."""

    def __init__(self, decoded: "_esker.Points", masked: bool, distances: np.ndarray, ends: np.ndarray) -> None:
        super().__init__(decoded, masked)
        self._distances = distances
        self._offsets = np.concatenate([np.zeros(1, np.int64), ends.astype(np.int64)])

    @property
    def distances(self) -> np.ndarray:
        """The distance of each neighbour, in units of the CRS."""
        return self._distances

    @property
    def offsets(self) -> np.ndarray:
        """Where the neighbours of each point begin and those of the last end: point ``i`` has those from ``offsets[i]`` up
        to ``offsets[i + 1]``, which are fewer than were asked for if no more match."""
        return self._offsets


class Density:
    """Points in squares of a grid in plan: row ``j`` and column ``i`` of each array are about the points with ``x`` from
    ``x0 + i * side`` and ``y`` from ``y0 + j * side``, up to the next."""

    def __init__(self, side: float, arrays: Any, first: Any, size: Any) -> None:
        self.side = side
        # The side is the decimal that it is written as: -3 sides of 0.1 are -0.3.
        exact = Fraction(repr(side))
        #: The low edges of the first square.
        self.x0, self.y0 = float(first[0] * exact), float(first[1] * exact)
        shape = (size[1], size[0])
        #: Points in each square.
        self.counts: np.ndarray = arrays[0].reshape(shape)
        #: The least height in each square, NaN where there is no point.
        self.lowest: np.ndarray = arrays[1].reshape(shape)
        #: The greatest height in each square.
        self.highest: np.ndarray = arrays[2].reshape(shape)

    def __repr__(self) -> str:
        rows, columns = self.counts.shape
        return f"<esker.Density of {columns} x {rows} squares of {self.side}>"
