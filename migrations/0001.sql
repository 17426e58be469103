-- Format version 1. docs/format.md says what every column means and which invariants hold.
-- `checksum` is over all other columns of the row, in this order (src/store/checksum.rs), but for `bytes` of a chunk, which
-- `pieces` has checksums of.

CREATE TABLE site (
    id            INTEGER PRIMARY KEY CHECK (id = 1),
    store_id      BLOB    NOT NULL,
    quantum       TEXT    NOT NULL,
    phase         TEXT    NOT NULL,
    g             INTEGER NOT NULL,
    leaf_capacity INTEGER NOT NULL,
    roots         BLOB    NOT NULL,
    crs           TEXT,
    generation    INTEGER NOT NULL,
    next_chunk    INTEGER NOT NULL,
    next_scan     INTEGER NOT NULL,
    nodes         INTEGER NOT NULL,
    scans         INTEGER NOT NULL,
    attributes    INTEGER NOT NULL,
    log           INTEGER NOT NULL,
    log_before    INTEGER NOT NULL,
    checksum      INTEGER NOT NULL
) STRICT;

CREATE TABLE scan (
    id            INTEGER PRIMARY KEY,
    name          TEXT    NOT NULL UNIQUE,
    source        TEXT    NOT NULL,
    source_bytes  INTEGER NOT NULL,
    identity      BLOB    NOT NULL,
    time          INTEGER NOT NULL,
    pose          BLOB    NOT NULL,
    read          INTEGER NOT NULL,
    stored        INTEGER NOT NULL,
    not_finite    INTEGER NOT NULL,
    out_of_range  INTEGER NOT NULL,
    truncated     INTEGER NOT NULL,
    bounds        BLOB,
    exactness     TEXT    NOT NULL,
    largest_error REAL    NOT NULL,
    format        TEXT    NOT NULL,
    las           TEXT,
    vlrs          BLOB,
    color_depth   INTEGER,
    visible       INTEGER NOT NULL,
    attributes    BLOB    NOT NULL,
    crs           TEXT,
    checksum      INTEGER NOT NULL
) STRICT;

CREATE TABLE attribute (
    id          INTEGER PRIMARY KEY,
    name        TEXT    NOT NULL,
    type        TEXT    NOT NULL,
    scaling     BLOB,
    no_data     BLOB,
    description TEXT    NOT NULL,
    checksum    INTEGER NOT NULL
) STRICT;

CREATE UNIQUE INDEX attribute_identity ON attribute (name, type, ifnull(scaling, x''), ifnull(no_data, x''));

CREATE TABLE node (
    layer    INTEGER NOT NULL,
    key      BLOB    NOT NULL,
    head     BLOB    NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (layer, key)
) STRICT, WITHOUT ROWID;

CREATE TABLE zone (
    layer    INTEGER NOT NULL,
    key      BLOB    NOT NULL,
    zones    BLOB    NOT NULL,
    checksum INTEGER NOT NULL,
    PRIMARY KEY (layer, key)
) STRICT, WITHOUT ROWID;

CREATE TABLE chunk (
    id       INTEGER PRIMARY KEY,
    layer    INTEGER NOT NULL,
    key      BLOB    NOT NULL,
    part     INTEGER NOT NULL,
    slot     INTEGER NOT NULL,
    points   INTEGER NOT NULL,
    codec    INTEGER NOT NULL,
    pieces   BLOB    NOT NULL,
    checksum INTEGER NOT NULL,
    bytes    BLOB    NOT NULL
) STRICT;

-- Ranges of chunk ids that a flip left without a node row; they are removed after it.
CREATE TABLE garbage (
    first INTEGER PRIMARY KEY,
    last  INTEGER NOT NULL
) STRICT;

CREATE TABLE bookmark (
    name     TEXT    PRIMARY KEY NOT NULL,
    camera   TEXT    NOT NULL,
    checksum INTEGER NOT NULL
) STRICT, WITHOUT ROWID;
