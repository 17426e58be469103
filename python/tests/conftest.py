"""Stores to ask, and the same points as laspy reads them."""

import json
import os
import pathlib
import subprocess
from decimal import Decimal

import esker
import laspy
import numpy as np
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]

#: laspy's names of what Esker calls otherwise.
RENAMED = {
    "scanner_channel": "ScanChannel",
    "scan_angle": "ScanAngleRank",
    "scan_angle_rank": "ScanAngleRank",
    "nir": "Infrared",
}


def pascal(name):
    """``gps_time`` is ``GpsTime``."""
    return RENAMED.get(name, "".join(word.capitalize() for word in name.split("_")))


class Site:
    """A store, and its points as they are in its files."""

    def __init__(self, path, files):
        self.path = str(path)
        self.files = [str(file) for file in files]
        self.report = esker.ingest(self.path, self.files)
        self.store = esker.open(self.path)
        info = self.store.info
        self.quantum, self.phase = np.array(info["quantum"]), np.array(info["phase"])
        self.bounds = np.array([info["bounds"]["min"], info["bounds"]["max"]])

    def truth(self):
        """One structured array with lattice positions, ``scan`` and the attributes, from laspy."""
        return np.concatenate([self.of_file(i + 1, file) for i, file in enumerate(self.files)])

    def of_file(self, scan, file):
        las = laspy.read(file)
        header = las.header
        extra = set(las.point_format.extra_dimension_names)
        columns = {}
        for axis in range(3):
            world = las["XYZ"[axis]] * header.scales[axis] + header.offsets[axis]
            columns["XYZ"[axis]] = np.rint((world - self.phase[axis]) / self.quantum[axis]).astype(np.int64)
        columns["scan"] = np.full(len(las.points), scan, np.uint32)
        for name in las.point_format.dimension_names:
            if name in "XYZ" or "wavepacket" in name or name in ("return_point_wave_location", "x_t", "y_t", "z_t"):
                continue
            values = np.asarray(las[name])
            if values.ndim == 1:
                columns[name if name in extra else pascal(name)] = values
        records = np.empty(len(las.points), [(name, column.dtype) for name, column in columns.items()])
        for name, column in columns.items():
            records[name] = column
        return records

    def world(self, records):
        """World coordinates of lattice positions: the nearest number to the decimal that each is."""
        return np.stack([self._axis(i, records["XYZ"[i]]) for i in range(3)], axis=1)

    def _axis(self, axis, steps):
        quantum, phase = Decimal(repr(self.quantum[axis].item())), Decimal(repr(self.phase[axis].item()))
        digits = max(0, -quantum.as_tuple().exponent, -phase.as_tuple().exponent)
        units = steps * int(quantum.scaleb(digits)) + int(phase.scaleb(digits))
        return units / 10**digits


def sorted_rows(columns, names):
    """Rows of these columns in an order of their own, to compare multisets of points."""
    order = np.lexsort([np.asarray(columns[name]) for name in reversed(names)])
    return {name: np.asarray(columns[name])[order] for name in names}


def assert_same_points(found, expected):
    """The same multiset of points, in every field that ``expected`` has."""
    names = list(expected.dtype.names)
    assert len(found) == len(expected)
    found, expected = sorted_rows(found, names), sorted_rows(expected, names)
    for name in names:
        np.testing.assert_array_equal(found[name], expected[name], err_msg=name)


@pytest.fixture(scope="session")
def site(tmp_path_factory):
    """Three overlapping scans of 20,000 points."""
    folder = tmp_path_factory.mktemp("site")
    files = esker.generate("site", 60_000, folder / "scans", seed=3, scans=3)
    return Site(folder / "site.esker", files)


@pytest.fixture(scope="session")
def large(tmp_path_factory):
    """A million points: long enough to be interrupted, large enough to weigh."""
    folder = tmp_path_factory.mktemp("large")
    files = esker.generate("terrain", 1_000_000, folder / "terrain.las")
    return Site(folder / "terrain.esker", files)


@pytest.fixture(scope="session")
def program():
    """Runs the command line: its stdout, and what it says of an answer."""
    path = os.environ.get("ESKER_PROGRAM") or ROOT / "target" / "debug" / "esker"
    assert os.path.exists(path), f"{path}: build the program, or name it in ESKER_PROGRAM"

    def run(*arguments):
        done = subprocess.run([path, *map(str, arguments)], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return done.stdout, done.stderr

    return run


@pytest.fixture(scope="session")
def report_of(program):
    def report(*arguments):
        return json.loads(program(*arguments, "--json")[0])

    return report


@pytest.fixture(scope="session")
def data():
    """Real point clouds; tests that want them are skipped in a bare clone."""
    folder = pathlib.Path(os.environ.get("ESKER_DATA") or ROOT.parent / "shared" / "data")
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    return folder
