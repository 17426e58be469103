#!/bin/sh
# The main job from nothing: sets the machine up, builds Esker, makes a site of several overlapping scans, stores it,
# takes a region out as LAZ and draws a picture. Says where everything is.
#
# usage: tools/demo.sh [FOLDER]      default folder: demo
set -eu
cd "$(dirname "$0")/.."
out=${1:-demo}
sh tools/setup.sh
: "${XDG_RUNTIME_DIR:=${TMPDIR:-/tmp}}"
export XDG_RUNTIME_DIR

echo "== building (a few minutes the first time)" >&2
cargo build --release --locked
esker=${CARGO_TARGET_DIR:-target}/release/esker

rm -rf "$out"
mkdir -p "$out"
echo "== making a site of five scans, 4 million points" >&2
"$esker" generate site --points 4000000 --seed 1 -o "$out/scans"
echo "== storing it" >&2
"$esker" ingest "$out/site.esker" "$out/scans"
"$esker" info "$out/site.esker"
echo "== 30 by 30 metres in the middle, as LAZ" >&2
"$esker" query "$out/site.esker" --box 689985,5329985,690015,5330015 -o "$out/region.laz"
echo "== the ground at 25 cm" >&2
"$esker" query "$out/site.esker" --where 'Classification = 2' --max-error 0.25 -o "$out/ground.laz"
echo "== a picture of the whole site" >&2
"$esker" render "$out/site.esker" -o "$out/site.png"
"$esker" verify "$out/site.esker"

echo
echo "store    $out/site.esker"
echo "region   $out/region.laz"
echo "ground   $out/ground.laz"
echo "picture  $out/site.png"
echo "to walk through it, where there is a display:  $esker view $out/site.esker"
