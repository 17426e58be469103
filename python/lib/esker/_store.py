"""Stores: asked, and changed."""

from __future__ import annotations

import json
import logging
import os
import warnings
from typing import TYPE_CHECKING, Any, Callable, Dict, Iterable, List, Optional, Sequence, TypedDict, Union

import numpy as np

from . import _arguments, _esker
from ._points import Answer, Batches, Density, Neighbors, counted
from .errors import EskerError, EskerWarning

if TYPE_CHECKING:
    from typing_extensions import Unpack

PathLike = Union[str, "os.PathLike[str]"]
Names = Union[str, int, Sequence[Union[str, int]]]
Progress = Callable[[str, int, int], Any]
#: Of work of which nobody knows how much there is.
OpenProgress = Callable[[str, int, Optional[int]], Any]

_log = logging.getLogger("esker")


class ExportedKeywords(TypedDict, total=False):
    """The keywords of :meth:`Store.query` that say which points a file gets."""

    box: Any
    closed: bool
    sphere: Sequence[float]
    obox: Sequence[float]
    polygon: Any
    z: Sequence[float]
    frustum: Any
    region: str
    where: str
    scans: Names
    view: Union[PathLike, Dict[str, Any]]
    max_error_px: Optional[float]
    policy: str
    max_error: float
    spacing: float
    level: int
    capacity: Union[int, float]
    attributes: Names


class QueryKeywords(ExportedKeywords, total=False):
    """The keywords of :meth:`Store.query`."""

    positions: str
    raw: bool
    masked: bool
    with_scan: bool


class ChangeKeywords(TypedDict, total=False):
    """The keywords of all changes."""

    memory: int
    threads: int
    wait: bool
    progress: Progress


class ReplaceKeywords(ChangeKeywords, total=False):
    """The keywords of :meth:`Store.replace`."""

    crs: Any
    ignore_crs: bool
    name: str
    poses: Sequence[Any]
    columns: Sequence[str]
    strict: bool


class IngestKeywords(ReplaceKeywords, total=False):
    """The keywords of :func:`ingest`."""

    quantum: Union[float, Sequence[float]]
    phase: Union[float, Sequence[float]]
    lattice: PathLike
    recursive: bool
    keep_going: bool


class Reader:
    """What can be asked of a store. In the examples ``store`` is a site of three scans, made by
    :func:`esker.generate`."""

    def __init__(self, reader: _esker.Reader, path: str) -> None:
        self._reader = reader
        self._path = path

    @property
    def path(self) -> str:
        """The file."""
        return self._path

    @property
    def generation(self) -> int:
        """Counts committed changes."""
        return self._reader.generation()

    @property
    def info(self) -> Dict[str, Any]:
        """What the store holds, as the command line's ``info --json``: points, bounds, quantum, CRS, attributes and what
        they cost.

        >>> info = store.info
        >>> info["points"], info["scans"], info["quantum"]
        (60000, 3, [0.001, 0.001, 0.001])

        ``bounds`` has a maximum one quantum beyond the last point, so that it takes everything when used as a box:

        >>> store.count(box=info["bounds"]["min"] + info["bounds"]["max"])
        60000
        """
        info = json.loads(self._reader.info())
        for attribute in info["attributes"]:
            attribute.update({word: _number(attribute[word]) for word in ("min", "max")})
        return info

    @property
    def bounds(self) -> Optional[np.ndarray]:
        """Low and high corner as two rows, the latter one quantum beyond the last point, so that it takes everything when
        used as a box; ``None`` without points.

        >>> store.bounds.shape, store.count(box=store.bounds)
        ((2, 3), 60000)
        """
        bounds = self.info["bounds"]
        return None if bounds is None else np.array([bounds["min"], bounds["max"]])

    @property
    def cache(self) -> Dict[str, int]:
        """What is kept in memory of what was read: bytes, and how often something was there.

        >>> sorted(store.cache)
        ['block_bytes', 'block_hits', 'block_misses', 'row_bytes', 'row_hits', 'row_misses']
        """
        return json.loads(self._reader.cache())

    @property
    def scans(self) -> List[Dict[str, Any]]:
        """The scans, as the command line's ``scans --json``: id, name, stored, pose, bounds, visible, ...

        >>> [(scan["id"], scan["name"], scan["stored"]) for scan in store.scans]
        [(1, 'site_1', 20000), (2, 'site_2', 20000), (3, 'site_3', 20000)]
        """
        return json.loads(self._reader.scans())

    @property
    def attributes(self) -> List[Dict[str, Any]]:
        """Name (a LAS dimension's where there is one) and type of each attribute; scaling, no_data and description of
        those that have them.

        >>> [(a["name"], a["ty"]) for a in store.attributes if a["name"].startswith("G")]
        [('GpsTime', 'f64'), ('Green', 'u16')]
        """
        return sorted(json.loads(self._reader.attributes()), key=lambda a: (a["name"], a["ty"]))

    @property
    def bookmarks(self) -> Dict[str, Dict[str, Any]]:
        """Named cameras that are kept in the store, as ``query(view=...)`` takes them.

        >>> plan = {"eye": [0, 0, 90], "target": [0, 0, 0], "up": [0, 1, 0],
        ...         "projection": "orthographic", "height": 50, "size": [640, 480]}
        >>> store.keep_bookmark("plan", plan), list(store.bookmarks)
        (False, ['plan'])
        >>> store.remove_bookmark("plan")
        """
        return {name: json.loads(view) for name, view in self._reader.bookmarks()}

    def query(
        self,
        *,
        box: Any = None,
        closed: bool = False,
        sphere: Optional[Sequence[float]] = None,
        obox: Optional[Sequence[float]] = None,
        polygon: Any = None,
        z: Optional[Sequence[float]] = None,
        frustum: Any = None,
        region: Optional[str] = None,
        where: Optional[str] = None,
        scans: Optional[Names] = None,
        view: Optional[Union[PathLike, Dict[str, Any]]] = None,
        max_error_px: Optional[float] = None,
        policy: Optional[str] = None,
        max_error: Optional[float] = None,
        spacing: Optional[float] = None,
        level: Optional[int] = None,
        capacity: Optional[Union[int, float]] = None,
        attributes: Optional[Names] = None,
        positions: str = "world",
        raw: bool = False,
        masked: bool = False,
        with_scan: bool = False,
    ) -> Answer:
        """The points in a region for which a filter is true, at a detail: exactly those that the command line gives.

        Where (inside all that are given):

        ``box``
            ``(x0, y0, x1, y1)`` or ``(x0, y0, z0, x1, y1, z1)``, or low and high corner as two rows; half-open: a point on a
            maximum face is outside, unless ``closed`` is true. ``float("inf")`` is a number.
        ``sphere``
            ``(x, y, z, radius)``.
        ``obox``
            ``(x, y, z, sx, sy, sz, yaw)`` or with ``pitch, roll``: the centre, full sides, angles in degrees.
        ``polygon``
            WKT or GeoJSON, as text, as a file, as a dict, or as an object with ``__geo_interface__`` such as shapely's, with
            holes and several parts; or the vertices as rows of x and y. Half-open like a box: neighbours that share an edge
            share no point.
        ``z``
            ``(from, up_to)``: heights, half-open.
        ``frustum``
            What a camera sees: a view file, its content as a dict, or a clip matrix.
        ``region``
            An expression of shapes: ``"polygon((0 0, 9 0, 9 9, 0 0)) and z(0, 4) and not sphere(1, 2, 3, 1)"``.

        Which:

        ``where``
            An expression over attributes, ``X``, ``Y``, ``Z`` and ``scan``: ``"Classification in (2, 9) and Z < 100"``.
        ``scans``
            Names, or ids as ints. Hidden scans take part only if they are named.

        How fine (everything, if nothing is said):

        ``max_error``
            Thinned to the coarsest cells with which every matching point is within this distance of a kept one.
        ``spacing``, ``level``
            One point in each cell of at most this side; of this level.
        ``view``, ``max_error_px``
            What a camera needs, until spacing is below so many pixels (1 unless said): a view file, or its content as a dict
            (``eye``, ``target``, ``size``, ...).
        ``policy``
            How a view spreads its points: ``"screen"``, by their error in pixels, or ``"distance"``, by ratios that fall with
            distance: ``"distance,amount=2,levels=16,cube=minimum,min-ratio=0.001,split=10"``.
        ``capacity``
            At most so many points, with any of these: an even thinning.

        What of each point:

        ``attributes``
            Names, looked up without regard to case and underscores, laspy's too. All, if nothing is said; ``[]`` for
            positions alone. What is not asked for is not read.
        ``positions``
            ``"world"``: ``x``, ``y``, ``z`` as float64. ``"lattice"``: ``X``, ``Y``, ``Z`` as exact int64, of which
            ``phase + quantum * X`` is the coordinate (``info`` has both).
        ``raw``
            Stored values of attributes that have a scale and an offset (extra bytes), instead of real ones in float64.
        ``masked``
            Masked arrays, with a mask where a scan lacks the attribute or the value is its no-data value. Otherwise there
            is 0 or the no-data value there; :attr:`Answer.nullable` names the attributes that are concerned.
        ``with_scan``
            A field ``scan`` with the id of each point's scan.

        >>> x, y = 690_000, 5_330_000
        >>> ground = store.query(box=(x, y, x + 20, y + 20), where="Classification = 2", attributes=["Intensity"])
        >>> ground.points.dtype.names
        ('x', 'y', 'z', 'Intensity')
        >>> bool((ground["x"] < x + 20).all()), ground.error_bound
        (True, 0.0)
        >>> coarse = store.query(max_error=2.0)
        >>> len(coarse) < 60_000 and coarse.error_bound <= 2.0
        True
        >>> len(store.query(capacity=1000, attributes=[]))
        1000

        Raises :exc:`QueryError`, :exc:`FilterError` and :exc:`UnknownNameError` for what makes no sense:

        >>> store.query(attributes="intensty")
        Traceback (most recent call last):
        esker.UnknownNameError: there is no attribute "intensty"; did you mean "Intensity"?

        The interpreter's lock is released meanwhile; Ctrl-C interrupts.
        """
        keywords = dict(locals())
        del keywords["self"]
        options = self._asked(keywords)
        decoded, report = self._reader.query(options)
        answer = Answer(decoded, masked, report)
        _warn_of_nothing(answer.region_misses_site)
        return answer

    def batches(self, size: int = 1_000_000, **keywords: Unpack[QueryKeywords]) -> Batches:
        """The points of :meth:`query` in the same order, ``size`` at a time (the last batch has what is left), in memory
        that does not grow with the answer. The store is read ahead a little while a batch is worked on.

        >>> heights = [batch["z"].max() for batch in store.batches(25_000, attributes=[])]
        >>> len(heights)
        3

        An iterator that is not used up keeps its generation and a few decoded batches until it is closed:

        >>> with store.batches(1000, where="Classification = 2") as batches:
        ...     first = next(batches)
        >>> len(first)
        1000
        """
        size = _arguments.count(size, "size")
        options = self._asked(keywords)
        return Batches(self._reader.batches(options, size), options["masked"])

    def count(self, **keywords: Unpack[QueryKeywords]) -> int:
        """How many points :meth:`query` would give; reads only what that needs.

        >>> store.count(scans="site_2")
        20000
        """
        report = json.loads(self._reader.count(self._asked(keywords)))
        _warn_of_nothing(report["region_misses_site"])
        return report["points"]

    def explain(self, **keywords: Unpack[QueryKeywords]) -> Dict[str, Any]:
        """Why each node is taken, tested, refused or cut for an answer, as the command line's ``query --explain --json``.

        >>> explanation = store.explain(capacity=1000)
        >>> sum(node["taken"] for node in explanation["nodes"]), explanation["nodes"][0]["verdict"]
        (1000, 'taken')
        """
        return json.loads(self._reader.explain(self._asked(keywords)))

    def summary(self, **keywords: Unpack[QueryKeywords]) -> Dict[str, Any]:
        """What the command line's ``query --json`` says of an answer: its error bound, what it cost, and least, greatest
        and mean value of ``X``, ``Y``, ``Z`` and the attributes.

        >>> summary = store.summary(attributes=["Classification"])
        >>> summary["points"], [a["name"] for a in summary["attributes"]]
        (60000, ['X', 'Y', 'Z', 'Classification'])
        """
        report = json.loads(self._reader.summary(self._asked(keywords)))
        for attribute in report["attributes"]:
            # JSON has no infinite numbers.
            attribute.update({word: _number(attribute[word]) for word in ("min", "max", "mean")})
        _warn_of_nothing(report["region_misses_site"])
        return report

    def nearest(
        self, points: Any, k: int = 1, radius: Optional[float] = None, **keywords: Unpack[QueryKeywords]
    ) -> Neighbors:
        """The ``k`` matching points that are nearest to each of ``points`` (one place, or rows of x, y, z) and at most
        ``radius`` away: exact, whatever the filter.

        >>> near = store.nearest([[690_000, 5_330_000, 500]], k=3, where="Classification = 2", attributes=["Intensity"])
        >>> len(near), bool((near.distances[:-1] <= near.distances[1:]).all()), near.offsets.tolist()
        (3, True, [0, 3])
        """
        places = _arguments.places(points)
        options = self._asked(keywords)
        radius = _arguments.number(radius, "radius")
        found = self._reader.nearest(options, places, _arguments.count(k, "k"), radius)
        return Neighbors(found[0], options["masked"], *found[1:])

    def density(self, side: float, **keywords: Unpack[QueryKeywords]) -> Density:
        """Counts, least and greatest heights of the matching points in squares of this side; nodes that lie in one square
        are counted without being read.

        >>> density = store.density(5.0)
        >>> int(density.counts.sum())
        60000
        """
        options = self._asked({"attributes": [], **keywords})
        if side is None:
            raise TypeError("side must be a number, not None")
        side = _arguments.number(side, "side")
        return Density(side, *self._reader.density(options, side))

    def export(
        self,
        path: PathLike,
        *,
        format: Optional[str] = None,
        scale: Optional[Union[float, Sequence[float]]] = None,
        frame: str = "world",
        split_by: Optional[str] = None,
        with_scan: bool = False,
        overwrite: bool = False,
        progress: Optional[OpenProgress] = None,
        **keywords: Unpack[ExportedKeywords],
    ) -> Dict[str, Any]:
        """Writes the points of :meth:`query` to a LAS, LAZ, PLY, CSV, XYZ, NPY or NPZ file in bounded memory, as the command
        line's ``query -o``: the same points in the same order, in the scans' own version, format, scale and offset where
        these agree. Gives the answer's report, with the files, their points and,
        where it is split, their ``scan`` or ``class`` in ``outputs``.

        ``format``
            ``"las"``, ``"laz"``, ``"ply"``, ``"csv"``, ``"xyz"``, ``"npy"`` or ``"npz"``, if the name of the file does
            not say.
        ``scale``
            LAS and LAZ: coordinates in these steps, one number or one per axis.
        ``frame``
            ``"world"``, or ``"scan"`` for one scan as its scanner saw it.
        ``split_by``
            ``"scan"`` or ``"class"``: one file for each, ``out_NAME.laz`` or ``out_class2.laz`` for ``out.laz``.
        ``with_scan``
            A column ``Scan`` with the number of each point's scan; in LAS an extra byte.
        ``overwrite``
            Replace files that are there; otherwise they are an :exc:`ExistsError`.
        ``progress``
            Called with ``"writing"``, the points written and ``None`` some ten times a second. What it raises stops the
            work.

        >>> report = store.export(folder + "/ground.laz", where="Classification = 2", attributes=["Intensity"])
        >>> report["points"] == store.count(where="Classification = 2"), report["error_bound"]
        (True, 0.0)
        >>> parts = store.export(folder + "/part.las", split_by="scan")["outputs"]
        >>> [(os.path.basename(part["path"]), part["points"]) for part in parts]
        [('part_site_1.las', 20000), ('part_site_2.las', 20000), ('part_site_3.las', 20000)]

        The file appears when it is complete; Ctrl-C and errors leave nothing.
        """
        for word in ("positions", "raw", "masked"):
            if word in keywords:
                raise TypeError(f"{word} is about arrays; a file has its own form")
        output = _arguments.output(format, scale, frame, split_by, with_scan, overwrite)
        options = self._asked(keywords)
        report, notes = _esker.export(self._reader, options, path, output, _Listener(progress))
        for note in notes:
            _log.warning("%s", note)
        answer = json.loads(report)
        _warn_of_nothing(answer["region_misses_site"])
        return answer

    def verify(self, deep: bool = False) -> Dict[str, Any]:
        """Checks that the store is whole; ``deep``: also that every point is where the sampling rule puts it. Ctrl-C
        interrupts.

        >>> store.verify()["whole"]
        True
        """
        return json.loads(self._reader.verify(deep))

    def _asked(self, keywords: Any) -> Dict[str, Any]:
        given = dict(keywords)
        if "scans" in given:
            given["scans"] = _arguments.scans(given["scans"], lambda: self.scans)
        return _arguments.query(given)

    def close(self) -> None:
        """Gives up files and memory. Answers that were given stay; an iterator of batches goes on."""
        self._reader.close()

    @property
    def closed(self) -> bool:
        """Was it closed?"""
        return self._reader.is_closed()

    def __exit__(self, *_: object) -> None:
        self.close()

    def __len__(self) -> int:
        """How many points :meth:`query` gives if it is asked for all: those of all scans that are not hidden."""
        return self._reader.points()

    def __bool__(self) -> bool:
        """Also a store without points is one."""
        return True

    def __repr__(self) -> str:
        try:
            what = "closed" if self.closed else counted(len(self), "point")
        except EskerError as error:
            what = str(error)
        return f"<esker.{type(self).__name__} {self._path!r}: {what}>"


class Snapshot(Reader):
    """One generation of a store, whatever is committed after; from :meth:`Store.snapshot`."""

    def __enter__(self) -> Snapshot:
        return self

    def __reduce__(self) -> Any:
        raise TypeError("a snapshot belongs to its process; a store can be pickled")


class Store(Reader):
    """A store: answers are always of its newest generation, and scans can be added and taken away.

    Use :func:`esker.open`. May be shared by threads, not by a forked process.
    """

    def __enter__(self) -> Store:
        return self

    def __init__(self, path: PathLike, cache: Optional[int]) -> None:
        # Where it is stays true when the process goes to another folder.
        path = os.path.join(os.getcwd(), os.fsdecode(path))
        super().__init__(_esker.Reader(path, cache), path)
        self._cache_bytes = cache

    def __reduce__(self) -> Any:
        return Store, (self._path, self._cache_bytes)

    def snapshot(self) -> Snapshot:
        """The present generation, for several questions about the same state.

        >>> with store.snapshot() as now:
        ...     now.count() == len(now.query(attributes=[]))
        True
        """
        return Snapshot(self._reader.hold(), self._path)

    def ingest(self, inputs: Union[PathLike, Sequence[PathLike]], **keywords: Unpack[IngestKeywords]) -> Dict[str, Any]:
        """Adds point files: :func:`esker.ingest` into this store."""
        self._check_open()
        return ingest(self._path, inputs, **keywords)

    def remove(self, scans: Names, **keywords: Unpack[ChangeKeywords]) -> Dict[str, Any]:
        """Takes scans out, as if they had never been there."""
        _check_keywords("remove", keywords, ChangeKeywords.__annotations__)
        return self._changed(_esker.remove, self._named(scans), **keywords)

    def replace(
        self, scan: Union[str, int], source: Optional[PathLike] = None, **keywords: Unpack[ReplaceKeywords]
    ) -> Dict[str, Any]:
        """Puts a file in a scan's place, in one commit; without ``source`` its own file, read again."""
        _check_keywords("replace", keywords, ReplaceKeywords.__annotations__)
        return self._changed(_esker.replace, self._named([scan])[0], source, **keywords)

    def hide(self, scans: Names, **keywords: Unpack[ChangeKeywords]) -> List[str]:
        """Leaves scans out of answers that do not name them; gives the names of those that were visible.

        >>> store.hide("site_3"), store.count(), store.show("site_3"), store.count()
        (['site_3'], 40000, ['site_3'], 60000)
        """
        _check_keywords("hide", keywords, ChangeKeywords.__annotations__)
        return self._changed(_esker.set_visible, self._named(scans), False, **keywords)

    def show(self, scans: Names, **keywords: Unpack[ChangeKeywords]) -> List[str]:
        """Lets hidden scans take part again; gives the names of those that were hidden."""
        _check_keywords("show", keywords, ChangeKeywords.__annotations__)
        return self._changed(_esker.set_visible, self._named(scans), True, **keywords)

    def ingest_points(
        self, points: Any, name: str, *, progress: Optional[Progress] = None, **keywords: Any
    ) -> Dict[str, Any]:
        """Puts points in memory into the store, as a scan of that name; see :func:`esker.ingest_points`.

        >>> found = store.query(where="Classification = 6", attributes=["Intensity"])
        >>> report = store.ingest_points(found, "buildings")
        >>> report["points"] == store.count(scans="buildings") == len(found)
        True
        >>> store.remove("buildings")["points"] == len(found)
        True
        """
        self._check_open()
        return ingest_points(self._path, points, name, progress=progress, **keywords)

    def rename(self, scan: Union[str, int], name: str, **keywords: Unpack[ChangeKeywords]) -> str:
        """Gives a scan another name; gives the old one.

        >>> store.rename("site_3", "roof"), store.rename("roof", "site_3")
        ('site_3', 'roof')
        """
        _check_keywords("rename", keywords, ChangeKeywords.__annotations__)
        new = _required(name, "name")
        return str(self._changed(_esker.rename, self._named([scan])[0], new, **keywords))

    def set_crs(self, crs: Any, force: bool = False, **keywords: Unpack[ChangeKeywords]) -> Optional[str]:
        """Says in which coordinate reference system the site is: ``EPSG:N``, ``EPSG:N+V`` with a vertical one, WKT, or an
        object with ``to_wkt``. No coordinate changes. Gives a description of the one before; one that is known to be
        another takes ``force``."""
        _check_keywords("set_crs", keywords, ChangeKeywords.__annotations__)
        before: Optional[str] = self._changed(
            _esker.set_crs, _arguments.crs_text(crs), _arguments.flag(force, "force"), **keywords
        )
        return before

    def keep_bookmark(
        self,
        name: str,
        view: Union[PathLike, Dict[str, Any]],
        force: bool = False,
        **keywords: Unpack[ChangeKeywords],
    ) -> bool:
        """Keeps a camera in the store under a name, for the window and for ``esker render --bookmark``: a view as
        ``query(view=...)`` takes it. Says whether that name had another one before, which takes ``force``."""
        _check_keywords("keep_bookmark", keywords, ChangeKeywords.__annotations__)
        kept, json_view = _required(name, "name"), _arguments.view(view)
        if json_view is None:
            raise TypeError("view must be a view file or its content, not None")
        return bool(self._changed(_esker.keep_bookmark, kept, json_view, _arguments.flag(force, "force"), **keywords))

    def remove_bookmark(self, name: str, **keywords: Unpack[ChangeKeywords]) -> None:
        """Lets go of a camera that is kept in the store."""
        _check_keywords("remove_bookmark", keywords, ChangeKeywords.__annotations__)
        self._changed(_esker.remove_bookmark, _required(name, "name"), **keywords)

    def compact(self, copy: Optional[PathLike] = None, **keywords: Unpack[ChangeKeywords]) -> Dict[str, Any]:
        """Makes one layer of all and gives free space back; with ``copy``, in a new file."""
        _check_keywords("compact", keywords, ChangeKeywords.__annotations__)
        return self._changed(_esker.compact, copy, **keywords)

    def digest(self, **keywords: Unpack[ChangeKeywords]) -> Dict[str, str]:
        """Two hashes of what the store holds, however it came to hold it: ``points`` and ``scans``.

        >>> sorted(store.digest())
        ['points', 'scans']
        """
        _check_keywords("digest", keywords, ChangeKeywords.__annotations__)
        return dict(self._changed(_esker.digest, **keywords))

    def _named(self, scans: Any) -> List[str]:
        named: Optional[List[str]] = _arguments.scans(scans, lambda: self.scans)
        if named is None:
            raise TypeError("scans must be names, not None")
        return named

    def _changed(self, change: Callable[..., str], *arguments: Any, **keywords: Any) -> Any:
        self._check_open()
        return _changed(change, self._path, *arguments, **keywords)

    def _check_open(self) -> None:
        if self.closed:
            raise EskerError("the store is closed")
        # Raises where its file was moved: changes go by the name, and would begin another store there.
        self._reader.generation()


def open_store(path: PathLike, *, cache: Optional[Union[int, float]] = None) -> Store:
    """Opens a store.

    ``cache`` is how many bytes of what was read are kept in memory at most, for questions about the same places: 352 MiB
    if nothing is said, 0 for none.

    >>> with esker.open(path) as store:
    ...     store.info["points"]
    60000

    Raises :exc:`NotThereError` (a ``FileNotFoundError``) or :exc:`NotAStoreError`:

    >>> esker.open("nowhere.esker")
    Traceback (most recent call last):
    esker.NotThereError: nowhere.esker: there is no such store
    """
    if cache is not None:
        cache = _arguments.whole(cache, "cache")
        if cache < 0:
            raise ValueError(f"cache is {cache}; it must be 0 or more bytes")
    return Store(path, cache)


def ingest(
    path: PathLike,
    inputs: Union[PathLike, Sequence[PathLike]],
    *,
    progress: Optional[Progress] = None,
    **keywords: Any,
) -> Dict[str, Any]:
    """Puts point files into a store, which is made if it is not there; gives the report of the command line's
    ``ingest --json``.

    ``inputs`` are files (LAS, LAZ, COPC, PLY, E57, PTX, PTS, PCD, text) and folders. Scans that the store has already are
    skipped, so an interrupted ingest is resumed by calling it again.

    ``quantum``, ``phase``, ``lattice``
        Of a new store: numbers, one or one per axis; or another store to take them from.
    ``memory``, ``threads``, ``wait``
        Bytes to use at most; threads; wait while another process writes.
    ``crs``, ``ignore_crs``
        ``"EPSG:N"``, WKT, or an object with ``to_wkt`` such as pyproj's, instead of what the inputs say; take coordinates
        as they are though a CRS differs.
    ``name``, ``poses``, ``columns``
        Of a single scan; a 4 x 4 matrix for each input file; names of the columns of text files, ``"-"`` for one that is
        not read.
    ``recursive``, ``strict``, ``keep_going``
        Look into folders below; refuse truncated files; leave out inputs that can't be read, which the report then names
        as ``"unreadable"``, and store the others.
    ``progress``
        Called with the stage (``"reading"``, ``"building"``, ...), the points done and the points of the stage, some ten
        times a second, and once at the end. What it raises stops the ingest, and is raised again. If all was committed by
        then it stays, and a note of the exception (Python 3.11) says so.

    >>> report = esker.ingest(folder + "/new.esker", folder + "/site_1.las", name="first")
    >>> [(scan["name"], scan["stored"], scan["positions"]) for scan in report["scans"]]
    [('first', 20000, 'exact')]
    >>> len(esker.ingest(folder + "/new.esker", folder + "/site_1.las")["skipped"])
    1

    Ctrl-C, too, leaves the store at its last commit.
    """
    _check_keywords("ingest", keywords, IngestKeywords.__annotations__)
    report = _changed(_esker.ingest, path, _arguments.paths(inputs, "inputs"), progress=progress, **keywords)
    for note in report["notes"] + [f"{s['name']}: {w}" for s in report["scans"] for w in s["warnings"]]:
        _log.warning("%s", note)
    return report


def ingest_points(
    path: PathLike, points: Any, name: str, *, progress: Optional[Progress] = None, **keywords: Any
) -> Dict[str, Any]:
    """Puts points in memory into a store, which is made if it is not there, as a scan of that name; gives the report of
    :func:`ingest`.

    ``points`` are a structured array, a mapping of names to arrays (a table of pandas will do), an answer of
    :meth:`Store.query`, or rows of x, y, z. ``x``, ``y`` and ``z`` (or ``X``, ``Y``, ``Z``) are world coordinates; points
    where one is NaN or infinite are rejected and counted. All else is an attribute of its array's type, under the name that
    a PLY file's would have: ``intensity`` is ``Intensity``.

    ``quantum``, ``phase``, ``lattice``, ``memory``, ``threads``, ``wait``, ``crs``, ``ignore_crs``, ``strict``, ``progress``
        As for :func:`ingest`.
    ``poses``
        One 4 x 4 matrix, for points in a scan's own frame.

    The same points under any name are skipped, like a file that the store has.

    >>> import numpy as np
    >>> x = np.arange(1000) * 0.25
    >>> made = {"x": x, "y": x % 10, "z": np.sin(x), "confidence": np.full(1000, 0.5, np.float32)}
    >>> report = esker.ingest_points(folder + "/made.esker", made, "wave", quantum=0.001)
    >>> [(scan["name"], scan["stored"], scan["positions"]) for scan in report["scans"]]
    [('wave', 1000, 'rounded')]
    """
    if not isinstance(name, str) or not name.strip():
        raise TypeError(f"name must be a string with a letter at least, not {name!r}")
    _check_keywords("ingest_points", keywords, set(IngestKeywords.__annotations__) - _OF_FILES)
    report = _changed(_esker.ingest_table, path, name, _arguments.table(points), progress=progress, **keywords)
    for note in report["notes"] + [f"{s['name']}: {w}" for s in report["scans"] for w in s["warnings"]]:
        _log.warning("%s", note)
    return report


#: Keywords of files, which points in memory are not.
_OF_FILES = {"name", "columns", "recursive", "keep_going"}


def merge(out: PathLike, stores: Sequence[PathLike], **keywords: Unpack[ChangeKeywords]) -> Dict[str, Any]:
    """Joins stores on one lattice to a new one: what a single ingest of all their scans would have given."""
    _check_keywords("merge", keywords, ChangeKeywords.__annotations__)
    return _changed(_esker.merge, out, _arguments.paths(stores, "stores"), **keywords)


def generate(
    kind: str,
    points: Union[int, float],
    output: PathLike,
    *,
    seed: int = 1,
    scans: int = 5,
    laz: bool = False,
    force: bool = False,
) -> List[str]:
    """Makes a synthetic model to try things with, the same for the same seed, and gives the names of its files.

    ``"torus"``, ``"spheres"`` and ``"terrain"`` are a file that ends in ``.las`` or ``.laz``; ``"site"`` is a folder of
    ``scans`` files.

    >>> [os.path.basename(file) for file in esker.generate("torus", 1000, folder + "/torus.las")]
    ['torus.las']
    """
    options = {
        "seed": _arguments.count(seed, "seed", 0),
        "scans": min(_arguments.count(scans, "scans"), 2**32 - 1),
        "laz": _arguments.flag(laz, "laz"),
        "force": _arguments.flag(force, "force"),
    }
    files = _esker.generate(kind, _arguments.count(points, "points", 0), output, options)
    return [os.fspath(path) for path, _ in files]


def _number(value: Any) -> Any:
    """What JSON has as a string since it has no such number: ``inf`` or ``-inf``."""
    return float(value) if isinstance(value, str) else value


def _warn_of_nothing(region_misses_site: bool) -> None:
    if region_misses_site:
        # Where the method was called.
        warnings.warn("the region lies outside the site, or has no extent", EskerWarning, stacklevel=3)


class _Listener:
    """Who hears of a change."""

    def __init__(self, progress: Optional[Callable[..., Any]]) -> None:
        if progress is not None and not callable(progress):
            raise TypeError(f"progress must be called, which {progress!r} can't")
        self.progress = progress
        self.say = _log.info


def _check_keywords(name: str, keywords: Any, known: Iterable[str]) -> None:
    """Refuses what would do nothing."""
    unknown = sorted(keywords.keys() - set(known))
    if unknown:
        raise TypeError(f"{name}() got an unexpected keyword argument '{unknown[0]}'")


def _required(value: Any, name: str) -> str:
    text: Optional[str] = _arguments.text(value, name)
    if text is None:
        raise TypeError(f"{name} must be a string, not None")
    return text


def _changed(change: Callable[..., str], *arguments: Any, progress: Optional[Progress] = None, **keywords: Any) -> Any:
    return json.loads(change(*arguments, _arguments.changes(**keywords), _Listener(progress)))
