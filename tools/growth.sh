#!/bin/sh
# What it costs to add a scan of 200,000 points to stores of growing size, and to take it out again.
#
#   sh tools/growth.sh [FOLDER [MILLIONS...]]        (default: ./growth 5 20)
#
# Each site is a generated terrain; the scan is a square of it, so it overlaps as much of the site as it covers. Prints
# the seconds of the first ingest, of adding and of removing, and the rows of encoded columns that adding wrote.
set -eu
cd "$(dirname "$0")/.."
cargo build --release --locked --bin esker
esker=${CARGO_TARGET_DIR:-target}/release/esker
folder=${1:-growth}
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- 5 20
mkdir -p "$folder"

# A number of a JSON report.
number() {
    sed -n "s/^ *\"$1\": \([0-9.]*\).*/\1/p" | head -n 1
}

for millions in "$@"; do
    site=$folder/site-$millions
    [ -e "$site.las" ] || "$esker" generate terrain --points "${millions}M" -o "$site.las"
    rm -f "$site.esker"
    build=$("$esker" ingest "$site.esker" "$site.las" --json | number seconds)
    side=$(awk "BEGIN { print sqrt(0.2 / $millions) }")
    # A square with about 200,000 points, off the middle.
    area=$("$esker" info "$site.esker" | awk -v s="$side" '$1 == "bounds" {
        split($2, b, ","); w = b[4] - b[1]; h = b[5] - b[2]
        printf "%f,%f,%f,%f", b[1] + 0.3 * w, b[2] + 0.4 * h, b[1] + (0.3 + s) * w, b[2] + (0.4 + s) * h }')
    "$esker" query "$site.esker" --box "$area" -o "$folder/scan.las" --force
    added=$("$esker" ingest "$site.esker" "$folder/scan.las" --json)
    removed=$("$esker" remove "$site.esker" scan --json)
    echo "$millions M points: built in $build s; $(echo "$added" | number points) points added in" \
        "$(echo "$added" | number seconds) s, $(echo "$added" | number chunks_written) rows written;" \
        "removed in $(echo "$removed" | number seconds) s"
done
