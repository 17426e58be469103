"""What can go wrong, by what a caller can do about it. Messages are the library's: where, what, and the remedy."""

__all__ = [
    "DamagedError",
    "DiskFullError",
    "EskerError",
    "EskerWarning",
    "ExistsError",
    "FilterError",
    "FormatError",
    "InUseError",
    "IngestError",
    "NotAStoreError",
    "NotThereError",
    "QueryError",
    "ReadOnlyError",
    "UnknownNameError",
]


class EskerError(Exception):
    """Any error of Esker."""


class NotThereError(EskerError, FileNotFoundError):
    """There is no such file."""


class NotAStoreError(EskerError):
    """The file is no store, or one of a newer version."""


class ExistsError(EskerError, FileExistsError):
    """A file is there already, and is not replaced."""


class InUseError(EskerError):
    """Another process writes to the store: try again later, or give ``wait=True``."""


class DamagedError(EskerError):
    """A part of the store is not what was written; :meth:`esker.Store.verify` names all such parts."""


class ReadOnlyError(EskerError, PermissionError):
    """The place can't be written."""


class DiskFullError(EskerError):
    """There is no space left. What was committed is kept."""


class QueryError(EskerError, ValueError):
    """The query makes no sense: a region, a detail, or things that do not go together."""


class FilterError(QueryError):
    """The filter can't be read, or names what the store does not have.

    ``at`` is the place in the filter, in characters from its start.
    """

    def __init__(self, message, at=0):
        super().__init__(message)
        self.at = at


class UnknownNameError(QueryError):
    """There is no attribute or scan of this name; the message has the nearest one."""


class FormatError(EskerError):
    """A point file can't be read or written."""


class IngestError(EskerError):
    """An ingest or another change was refused: names, poses, CRS or lattice do not fit the store."""


class EskerWarning(UserWarning):
    """An answer may not be what was meant."""


for _name in __all__:
    # As users write them.
    globals()[_name].__module__ = "esker"
del _name
