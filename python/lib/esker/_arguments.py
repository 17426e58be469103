"""Keywords as users give them, brought into the one form that the extension takes."""

import json
import numbers as kinds
import operator
import os

import numpy as np

from ._points import Points
from .errors import QueryError

DEFAULTS = {
    "box": None,
    "closed": False,
    "sphere": None,
    "obox": None,
    "polygon": None,
    "z": None,
    "frustum": None,
    "region": None,
    "where": None,
    "scans": None,
    "view": None,
    "max_error_px": None,
    "policy": None,
    "max_error": None,
    "spacing": None,
    "level": None,
    "capacity": None,
    "attributes": None,
    "positions": "world",
    "raw": False,
    "masked": False,
    "with_scan": False,
}

MOST = 2**63 - 1


def whole(value, what):
    """A whole number, also one that is written as a float: ``1e6``."""
    if isinstance(value, kinds.Real) and not isinstance(value, kinds.Integral) and float(value).is_integer():
        value = int(value)
    try:
        return min(operator.index(value), MOST)
    except TypeError:
        raise TypeError(f"{what} must be a whole number, not {value!r}") from None


def count(value, what, least=1):
    """A whole number from 1 up, or from another."""
    value = whole(value, what)
    if value < least:
        raise ValueError(f"{what} is {value}; it must be {least} or more")
    return value


def flag(value, what):
    """Yes or no."""
    if not isinstance(value, (bool, np.bool_)):
        raise TypeError(f"{what} must be True or False, not {value!r}")
    return bool(value)


def path(value, what):
    """A file or a folder."""
    if not isinstance(value, (str, bytes, os.PathLike)):
        raise TypeError(f"{what} must be a path, not {value!r}")
    return os.fsdecode(value)


def paths(value, what):
    """Files and folders: several, or one alone."""
    if isinstance(value, (str, bytes, os.PathLike)):
        value = [value]
    try:
        value = list(value)
    except TypeError:
        raise TypeError(f"{what} must be paths, not {value!r}") from None
    return [path(one, what) for one in value]


def names(value, what):
    """A list of strings: several, or one alone."""
    if isinstance(value, (bytes, bytearray)):
        raise TypeError(f"{what} must be names, not {value!r}")
    value = _names(value, what)
    return None if value is None else [str(name) for name in value]


def scans(value, listed):
    """Names of scans that are given by name or number. A string is a name, or a number where no scan is called so; an int is
    always a number, the ``id`` of one of the scans that ``listed`` gives."""
    value = _names(value, "scans")
    if value is None or all(isinstance(scan, str) for scan in value):
        return value
    named = {scan["id"]: scan["name"] for scan in listed()}
    for number in value:
        if not isinstance(number, str) and number not in named:
            numbers = ", ".join(map(str, sorted(named))) or "none"
            raise QueryError(f"there is no scan number {number}; there are {numbers}")
    return [scan if isinstance(scan, str) else named[scan] for scan in value]


def _names(value, what):
    if value is None:
        return None
    if _is_name(value):
        value = [value]
    try:
        value = list(value)
    except TypeError:
        raise TypeError(f"{what} must be names, not {value!r}") from None
    for name in value:
        if not _is_name(name):
            raise TypeError(f"{what} must be names, not {name!r}")
    return value


def _is_name(value):
    return isinstance(value, (str, kinds.Integral)) and not isinstance(value, (bool, np.bool_))


def numbers(value, what):
    """A list of floats; rows of an array follow each other."""
    array = _floats(value, what)
    return None if array is None else array.ravel().tolist()


def row(value, what):
    """Floats that are one row."""
    array = _floats(value, what)
    if array is not None and array.ndim != 1:
        raise QueryError(f"{what} is one row of numbers; its shape is {array.shape}")
    return None if array is None else array.tolist()


def box(value):
    """Four or six floats, or a low and a high corner as two rows."""
    array = _floats(value, "box")
    if array is not None and array.ndim != 1 and array.shape not in ((2, 2), (2, 3)):
        raise QueryError(f"box is one row of numbers, or a low and a high corner as two rows; its shape is {array.shape}")
    return None if array is None else array.ravel().tolist()


def _floats(value, what):
    if value is None:
        return None
    if isinstance(value, str):
        raise TypeError(f"{what} must be numbers, not a string")
    try:
        array = np.asarray(value)
        # It would become NaN.
        if array.dtype == object and any(number is None for number in array.flat):
            raise TypeError
        return array.astype(np.float64)
    except (TypeError, ValueError) as error:
        raise type(error)(f"{what} must be numbers, not {value!r}") from None


def number(value, what):
    """A float."""
    if value is None:
        return None
    try:
        return float(value)
    except (TypeError, ValueError):
        raise TypeError(f"{what} must be a number, not {value!r}") from None


def places(value):
    """Rows of three coordinates: one place, or several."""
    try:
        array = np.ascontiguousarray(value, np.float64)
    except (TypeError, ValueError):
        raise TypeError(f"points must be rows of x, y and z, not {value!r}") from None
    if array.ndim == 1 and array.size in (0, 3):
        array = array.reshape(-1, 3)
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"points must be rows of x, y and z; their shape is {array.shape}")
    return array


def text(value, what):
    """A string."""
    if value is not None and not isinstance(value, str):
        raise TypeError(f"{what} must be a string, not {value!r}")
    return value


def view(value):
    """A view file's JSON: from its path, or from its content as a dict."""
    if value is None:
        return None
    if isinstance(value, (str, os.PathLike)):
        try:
            with open(value, encoding="utf-8") as file:
                return file.read()
        except FileNotFoundError:
            raise QueryError(f"{value}: there is no such view file") from None
        except (OSError, UnicodeDecodeError) as error:
            raise QueryError(f"{value}: reading the view failed: {getattr(error, 'strerror', None) or error}") from None
    return _json(value, "view")


def polygon(value):
    """WKT, GeoJSON or a file's name: as text, as GeoJSON's dict, as an object of shapely's kind, or as a ring of
    vertices."""
    if value is None or isinstance(value, str):
        return value
    if isinstance(value, os.PathLike):
        return os.fsdecode(value)
    # geopandas' objects know their CRS, but GeoJSON has it only where it is put.
    epsg = _epsg(getattr(value, "crs", None))
    value = getattr(value, "__geo_interface__", value)
    if isinstance(value, dict):
        value = _shapes(value)
    else:
        value = {"type": "Polygon", "coordinates": [_ring(value)]}
    if epsg is not None and "crs" not in value:
        value = {**value, "crs": {"type": "name", "properties": {"name": f"urn:ogc:def:crs:EPSG::{epsg}"}}}
    return _json(value, "polygon")


def _epsg(crs):
    """The EPSG code of an object of pyproj's kind, if it has one."""
    return crs.to_epsg() if hasattr(crs, "to_epsg") else None


def _shapes(geojson):
    """GeoJSON without the properties of its features, which may be anything."""
    kept = {word: value for word, value in geojson.items() if word != "properties"}
    if isinstance(kept.get("features"), (list, tuple)):
        kept["features"] = [_shapes(one) if isinstance(one, dict) else one for one in kept["features"]]
    return kept


def _ring(vertices):
    """A closed ring of x and y."""
    wrong = TypeError(f"polygon must be WKT, GeoJSON, a file or rows of x and y, not {vertices!r}")
    try:
        array = np.asarray(vertices, np.float64)
    except (TypeError, ValueError):
        raise wrong from None
    if array.ndim != 2 or array.shape[1] != 2:
        raise wrong
    ring = array.tolist()
    return ring if ring[:1] == ring[-1:] else ring + ring[:1]


def frustum(value):
    """A view, or the rows of a clip matrix, as JSON."""
    if value is None or isinstance(value, (str, os.PathLike)):
        return view(value)
    if isinstance(value, dict):
        return _json(value, "frustum")
    try:
        rows = [[float(number) for number in row] for row in value]
    except (TypeError, ValueError):
        raise TypeError(f"frustum must be a view or the rows of a clip matrix, not {value!r}") from None
    return _json({"clip_from_world": rows}, "frustum")


def _json(value, what):
    """JSON, which has no NaN."""
    try:
        return json.dumps(value, default=_plain, allow_nan=False)
    except TypeError as error:
        raise TypeError(f"{what} has {error}") from None
    except ValueError:
        raise QueryError(f"{what} has a number that is NaN or infinite: {value!r}") from None


def _plain(value):
    """What json does not know: numpy's arrays and numbers."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{value!r}, which has no place in JSON")


def query(given):
    """All keywords of a query."""
    unknown = given.keys() - DEFAULTS.keys()
    if unknown:
        raise TypeError(f"unexpected keyword: {', '.join(sorted(unknown))}")
    full = {**DEFAULTS, **given}
    positions = full.pop("positions")
    if positions not in ("world", "lattice"):
        raise QueryError(f'positions is {positions!r}; it must be "world" or "lattice"')
    full["lattice"] = positions == "lattice"
    full["box"] = box(full["box"])
    for word in ("sphere", "obox", "z"):
        full[word] = row(full[word], word)
    if full["z"] is not None and len(full["z"]) != 2:
        raise QueryError(f"z has 2 numbers, from and up to; there are {len(full['z'])}")
    full["polygon"] = polygon(full["polygon"])
    full["frustum"] = frustum(full["frustum"])
    full["region"] = text(full["region"], "region")
    full["where"] = text(full["where"], "where")
    full["scans"] = names(full["scans"], "scans")
    full["attributes"] = names(full["attributes"], "attributes")
    full["view"] = view(full["view"])
    full["policy"] = text(full["policy"], "policy")
    for word in ("max_error_px", "max_error", "spacing"):
        full[word] = number(full[word], word)
    if full["max_error_px"] is None:
        full["max_error_px"] = 1.0
    elif full["view"] is None:
        raise QueryError("max_error_px says where a view stops; give a view")
    for word in ("closed", "raw", "masked", "with_scan"):
        full[word] = flag(full[word], word)
    for word in ("level", "capacity"):
        if full[word] is not None:
            full[word] = whole(full[word], word)
    return full


def per_axis(value, what):
    """One number for all axes, or three."""
    if value is None:
        return None
    axes = numbers(value, what)
    if len(axes) not in (1, 3):
        raise ValueError(f"{what} is one number, or one per axis; there are {len(axes)}")
    return axes * (3 // len(axes))


def output(format, scale, frame, split_by, with_scan, overwrite):
    """All keywords of a file of points."""
    return {
        "format": text(format, "format"),
        "scale": per_axis(scale, "scale"),
        "frame": text(frame, "frame"),
        "split_by": text(split_by, "split_by"),
        "with_scan": flag(with_scan, "with_scan"),
        "overwrite": flag(overwrite, "overwrite"),
    }


def changes(
    quantum=None,
    phase=None,
    lattice=None,
    memory=None,
    threads=None,
    crs=None,
    ignore_crs=False,
    name=None,
    poses=(),
    columns=None,
    recursive=False,
    strict=False,
    keep_going=False,
    wait=False,
):
    """All keywords of a change."""
    if isinstance(columns, str):
        # As on the command line.
        columns = columns.split(",")
    return {
        "quantum": per_axis(quantum, "quantum"),
        "phase": per_axis(phase, "phase"),
        "lattice": None if lattice is None else path(lattice, "lattice"),
        "memory": None if memory is None else count(memory, "memory"),
        "threads": None if threads is None else count(threads, "threads"),
        "crs": None if crs is None else crs_text(crs),
        "ignore_crs": flag(ignore_crs, "ignore_crs"),
        "name": text(name, "name"),
        "poses": _matrices(poses),
        "columns": None if columns is None else ",".join(names(columns, "columns")),
        "recursive": flag(recursive, "recursive"),
        "strict": flag(strict, "strict"),
        "keep_going": flag(keep_going, "keep_going"),
        "wait": flag(wait, "wait"),
    }


def table(points):
    """The columns of points in memory, contiguous and in types that a store has: x, y and z first."""
    if isinstance(points, Points):
        if points.names[:3] == ("X", "Y", "Z"):
            raise TypeError('points are in lattice steps; ask for them with positions="world"')
        points = points.points
    names = getattr(getattr(points, "dtype", None), "names", None)
    if names is None and hasattr(points, "keys"):
        names = list(points.keys())
    if names is not None:
        columns = {str(name): points[name] for name in names}
        if len(columns) < len(names):
            raise TypeError(f"two columns are called the same: {', '.join(map(str, names))}")
    else:
        rows = np.asarray(points)
        if rows.ndim != 2 or rows.shape[1] != 3:
            raise TypeError(
                "points must be a structured array, a mapping of names to arrays, or rows of x, y, z, not "
                f"{type(points).__name__} of shape {rows.shape}"
            )
        columns = dict(zip("xyz", rows.T))
    axes = {}
    for axis in "xyz":
        found = [name for name in columns if name == axis] or [name for name in columns if name == axis.upper()]
        if not found:
            raise TypeError(f"points have no {axis}; there are {', '.join(columns) or 'no columns'}")
        axes[found[0]] = np.float64
    rest = {name: None for name in columns if name not in axes}
    return [(name, _column(name, columns[name], dtype)) for name, dtype in {**axes, **rest}.items()]


def _column(name, values, dtype):
    """The values of a column, in a type that a store has."""
    if np.ma.is_masked(values):
        raise TypeError(f"{name} is masked; fill it with what stands for no value")
    values = np.asarray(values)
    if values.ndim != 1:
        raise TypeError(f"{name} must have one value a point; its shape is {values.shape}")
    if values.dtype == np.bool_:
        values = values.astype(np.uint8)
    elif values.dtype == np.float16:
        values = values.astype(np.float32)
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8:
        raise TypeError(f"{name} must be whole or real numbers of up to 64 bits, not {values.dtype}")
    return np.ascontiguousarray(values, dtype=dtype or values.dtype.newbyteorder("="))


def crs_text(crs):
    """A CRS as text: one of pyproj's and others' objects is asked for its WKT."""
    if isinstance(crs, str):
        return crs
    if not hasattr(crs, "to_wkt"):
        raise TypeError(f"crs must be a string or an object with to_wkt, not {crs!r}")
    return crs.to_wkt()


def _matrices(poses):
    """The sixteen numbers of a row-major 4 x 4 matrix each."""
    try:
        matrices = [numbers(pose, "a pose") for pose in poses]
    except TypeError:
        matrices = [None]
    if any(matrix is None or len(matrix) != 16 for matrix in matrices):
        raise TypeError(f"poses must be a 4 x 4 matrix for each input file, not {poses!r}")
    return matrices
