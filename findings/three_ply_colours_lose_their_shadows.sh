#!/usr/bin/env bash
# three.js: its reader of PLY has 183 of 256 levels of a colour, and hardly any dark ones.
#
# three.js works in linear light, and `PLYLoader` turns the sRGB colours of a file into it. One
# would expect floats then. It keeps the type of the file, so linear light is rounded to a byte, which has
# too few steps for the dark half: 0 to 6 come out as 0, 7 to 17 as 13, 18 to 25 as 22.
# It matters to who shows scans, or the sparse points of a model, in a browser: shade, asphalt and
# forest have bands, and a cloud that is read and written again has lost them for good. Write
# colours as floats into the PLY: the loader keeps floats.
# Seen on 2026-12-01 with three 0.187.0: "uchar: Uint8Array, 183 levels of 256, up to 6 off, 0 to 19
# are drawn as 0 0 0 0 0 0 0 13 13 13 13 13 13 13 13 13 13 13 22 22", "float: Float32Array, 256
# levels of 256, up to 0 off".
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
npm init -y >/dev/null
npm install --silent --ignore-scripts three@0.187.0 >/dev/null
cat > levels.mjs <<'JS'
import { Color, REVISION } from 'three';
import { PLYLoader } from 'three/examples/jsm/loaders/PLYLoader.js';

console.log('three', REVISION);
const seen = {};
for (const type of ['uchar', 'float']) {
  const names = ['red', 'green', 'blue'].map((name) => `property ${type} ${name}`);
  const head = ['ply', 'format ascii 1.0', 'element vertex 256', 'property float x', 'property float y', 'property float z'];
  const rows = [...Array(256).keys()].map((level) => {
    const value = type === 'uchar' ? level : level / 255;
    return `0 0 0 ${value} ${value} ${value}`;
  });
  const stored = new PLYLoader().parse([...head, ...names, 'end_header', ...rows, ''].join('\n')).attributes.color;
  const color = new Color();
  const drawn = rows.map((_, level) => Math.round(255 * color.fromBufferAttribute(stored, level).convertLinearToSRGB().r));
  const most = Math.max(...drawn.map((value, level) => Math.abs(value - level)));
  seen[type] = [new Set(drawn).size, most];
  const kept = `${type}: ${stored.array.constructor.name}, ${seen[type][0]} levels of 256, up to ${most} off`;
  console.log(`${kept}, 0 to 19 are drawn as`, ...drawn.slice(0, 20));
}
process.exit(seen.uchar[0] < 200 && seen.uchar[1] >= 6 && seen.float[0] === 256 && seen.float[1] === 0 ? 0 : 1);
JS
node levels.mjs
