"""Points out of an Esker store, to numpy.

>>> import esker
>>> files = esker.generate("site", 60_000, folder, scans=3, force=True)
>>> report = esker.ingest(path, files)
>>> with esker.open(path) as store:
...     ground = store.query(where="Classification = 2", max_error=0.5, attributes=["Intensity"])
>>> ground.points.dtype.names
('x', 'y', 'z', 'Intensity')

Answers are exact, and say how good they are; see :meth:`Store.query`.
"""

from ._esker import VERSION as __version__
from ._points import Answer, Batches, Density, Neighbors, Points
from ._store import Snapshot, Store, generate, ingest, ingest_points, merge
from ._store import open_store as open
from .errors import (
    DamagedError,
    DiskFullError,
    EskerError,
    EskerWarning,
    ExistsError,
    FilterError,
    FormatError,
    InUseError,
    IngestError,
    NotAStoreError,
    NotThereError,
    QueryError,
    ReadOnlyError,
    UnknownNameError,
)

__all__ = [
    "Answer",
    "Batches",
    "DamagedError",
    "Density",
    "DiskFullError",
    "EskerError",
    "EskerWarning",
    "ExistsError",
    "FilterError",
    "FormatError",
    "InUseError",
    "IngestError",
    "Neighbors",
    "NotAStoreError",
    "NotThereError",
    "Points",
    "QueryError",
    "ReadOnlyError",
    "Snapshot",
    "Store",
    "UnknownNameError",
    "generate",
    "ingest",
    "ingest_points",
    "merge",
    "open",
]
