#!/bin/sh
# Does the cost of an answer follow the answer, or the size of the store? The same box out of stores of growing size that are
# equal around it.
#
#   sh tools/sensitive.sh STORE X,Y [FOLDER [SIDES...]]        (default: ./sensitive 210 460; in the store's unit)
#
# For each side the points of STORE in a square of that side around X,Y become a store of their own, in FOLDER; then a square
# with about 100,000 points around X,Y is written out of each of them and out of STORE, 11 times each, in turn. Prints, for
# each store: its points, the points of the answer, bytes read, points decoded, and the median and the range of the
# milliseconds of the whole process. Stores that are there are used again.
#
# ESKER: the program to measure, instead of the release build of this tree.
set -eu
cd "$(dirname "$0")/.."
if [ -z "${ESKER:-}" ]; then
    cargo build --release --locked --bin esker
    ESKER=${CARGO_TARGET_DIR:-target}/release/esker
fi
[ $# -ge 2 ] || { sed -n '2,14s/^# \{0,1\}//p' "$0"; exit 2; }
store=$1 x=${2%,*} y=${2#*,}
folder=${3:-sensitive}
shift 2
[ $# -gt 0 ] && shift
[ $# -gt 0 ] || set -- 210 460
mkdir -p "$folder"

# A number of a JSON report.
number() {
    sed -n "s/^ *\"$1\": \([0-9.]*\).*/\1/p" | head -n 1
}

# The square of a side around the place.
square() {
    awk -v x="$x" -v y="$y" -v s="$1" 'BEGIN { printf "%.3f,%.3f,%.3f,%.3f", x - s / 2, y - s / 2, x + s / 2, y + s / 2 }'
}

stores=
for side in "$@"; do
    part=$folder/side-$side
    if [ ! -e "$part.esker" ]; then
        "$ESKER" query "$store" --box "$(square "$side")" -o "$part.las" --force
        "$ESKER" ingest "$part.esker" "$part.las" --lattice "$store"
        rm "$part.las"
    fi
    stores="$stores $part.esker"
done
stores="$stores $store"

# The side that holds about 100,000 points.
inside=$("$ESKER" query "$store" --box "$(square 100)" --count)
side=$(awk -v n="$inside" 'BEGIN { print 100 * sqrt(100000 / n) }')
box=$(square "$side")

rm -f "$folder"/*.ms
for run in 0 1 2 3 4 5 6 7 8 9 10 11; do
    for one in $stores; do
        name=$(basename "$one")
        begin=$(date +%s%N)
        "$ESKER" query "$one" --box "$box" -o "$folder/answer.las" --force --json > "$folder/$name.json"
        end=$(date +%s%N)
        # The first is not counted: the file may have to be brought in.
        [ "$run" -eq 0 ] || echo $(((end - begin) / 10000)) >> "$folder/$name.ms"
    done
done
for one in $stores; do
    name=$(basename "$one")
    json=$folder/$name.json
    printf '%s points: %s in the answer, %s bytes read, %s points decoded, ' \
        "$("$ESKER" query "$one" --count)" "$(number points < "$json")" "$(number bytes_read < "$json")" \
        "$(number points_decoded < "$json")"
    sort -n "$folder/$name.ms" | awk '{ v[NR] = $1 / 100 } END { printf "%s ms (%s to %s)\n", v[int((NR + 1) / 2)], v[1], v[NR] }'
done
