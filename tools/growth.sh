#!/bin/sh
# What it costs to add a scan of 200,000 points to stores of growing size, and to take it out again.
#
#   sh tools/growth.sh [FOLDER [MILLIONS...]]        (default: ./growth 5 20; "5 20 80" takes 6 GB of disk)
#
# Each site is a generated terrain; the scans are five squares of it, moved by some centimetres, so they overlap as much of
# the site as they cover. Other sites: a `site-MILLIONS.esker` in the folder with the seconds of its first ingest in
# `site-MILLIONS.seconds` and the rows that it wrote in `site-MILLIONS.built`.
# Prints the seconds and rows of encoded columns of the first ingest, and medians and ranges of the seconds of adding and of
# removing and of the rows that they wrote. Sites that are there are used again.
#
# ESKER: the program to measure, instead of the release build of this tree.
set -eu
cd "$(dirname "$0")/.."
if [ -z "${ESKER:-}" ]; then
    cargo build --release --locked --bin esker
    ESKER=${CARGO_TARGET_DIR:-target}/release/esker
fi
folder=${1:-growth}
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- 5 20
mkdir -p "$folder"
printf '1 0 0 0.13\n0 1 0 0.07\n0 0 1 0.02\n0 0 0 1\n' > "$folder/pose.txt"

# A number of a JSON report.
number() {
    sed -n "s/^ *\"$1\": \([0-9.]*\).*/\1/p" | head -n 1
}

# Median, least and largest of the lines of a file.
spread() {
    sort -n "$1" | awk '{ v[NR] = $1 } END { printf "%s (%s to %s)", v[int((NR + 1) / 2)], v[1], v[NR] }'
}

for millions in "$@"; do
    site=$folder/site-$millions
    if [ ! -e "$site.esker" ]; then
        [ -e "$site.las" ] || "$ESKER" generate terrain --points "${millions}M" -o "$site.las"
        built=$("$ESKER" ingest "$site.esker" "$site.las" --json)
        echo "$built" | number seconds > "$site.seconds"
        echo "$built" | number chunks_written > "$site.built"
    fi
    rm -f "$site.points" "$site.added" "$site.removed" "$site.rows" "$site.rewritten"
    for place in 0.05,0.15 0.3,0.4 0.45,0.5 0.6,0.2 0.75,0.45; do
        scan=$site-scan-$place.las
        if [ ! -e "$scan" ]; then
            # A square with about 200,000 points.
            area=$("$ESKER" info "$site.esker" | awk -v s="$(awk "BEGIN { print sqrt(0.2 / $millions) }")" -v place="$place" '
                $1 == "bounds" {
                    split($2, b, ","); split(place, p, ","); w = b[4] - b[1]; h = b[5] - b[2]
                    printf "%f,%f,%f,%f", b[1] + p[1] * w, b[2] + p[2] * h, b[1] + (p[1] + s) * w, b[2] + (p[2] + s) * h
                }')
            "$ESKER" query "$site.esker" --box "$area" -o "$scan"
        fi
        added=$("$ESKER" ingest "$site.esker" "$scan" --name scan --pose "$folder/pose.txt" --json)
        echo "$added" | number points >> "$site.points"
        echo "$added" | number seconds >> "$site.added"
        echo "$added" | number chunks_written >> "$site.rows"
        removed=$("$ESKER" remove "$site.esker" scan --json)
        echo "$removed" | number seconds >> "$site.removed"
        echo "$removed" | number chunks_written >> "$site.rewritten"
    done
    echo "$millions M points: built in $(cat "$site.seconds") s, $(cat "$site.built") rows;" \
        "$(spread "$site.points") points added in $(spread "$site.added") s, $(spread "$site.rows") rows;" \
        "removed in $(spread "$site.removed") s, $(spread "$site.rewritten") rows"
done
